"""Blocks `elevation_map` and `grid_map`, which write a height map around the robot.

    deferred:
      - realsense: {cloud: true}
      - elevation_map: {handle: realsense_cloud_handle, position: [0.3, 0.0, 0.1]}

`elevation_map` takes frames of a camera or a scanner. Each new one is turned into the world by the
pose that the base had at the frame's time. What it costs is bounded by `points`; ticks without a
new frame only keep the pose. Behind `send` it delays no command: a policy sees the map in the next
tick. Replays give it again from records. `grid_map` takes the maps on a ROS topic.
"""

from __future__ import annotations

import math
import time
from typing import Annotated, Any, Literal

import numpy as np

from unicon_base import Fault, UniconError, alternatives, one_line
from unicon_base.arrays import Array
from unicon_base.schema.marks import Point, Quat, Within, positive
from unicon_core.models.camera import Intrinsics
from unicon_core.platforms.kit.base import rotation
from unicon_core.policies.perception import Frames
from unicon_core.states import StateSpec
from unicon_core.terrain.height_map import ElevationGrid, height_map_states
from unicon_core.workflow.autowire import BuildContext
from unicon_msgs_map import Decoder, SubscribeSpec
from unicon_msgs_map.codec.careful import Rejected
from unicon_msgs_map.layout.messages import shared_messages
from unicon_msgs_map.spec import RosName
from unicon_ros import compat
from unicon_ros.bridge.images import CLOUD, IMAGE, rays
from unicon_ros.bridge.map_fit import message_class
from unicon_ros.bridge.own_node import OwnNode, calm_middleware_threads
from unicon_ros.bridge.qos import LATCHED, LATEST
from unicon_ros.bridge.topics import TopicIn
from unicon_ros.peripheral import Stale

MOST_CELLS = 128
"""Along each side: to fill the holes of 80 x 80 cells takes 0.3 ms, of so many 1 ms."""
KEPT = 2.0
"""How long poses are kept for frames that come late, in [s]."""
APART = 0.05
"""A frame is left out where no pose is nearer to its time, in [s]."""
OPTICAL = (0.5, -0.5, 0.5, -0.5)
"""Optical frame (z forward, x right, y down) of a camera that looks along the base's x, wxyz."""

Size = Annotated[float, Within(0.2, 20.0, "m")]
Resolution = Annotated[float, Within(0.02, 1.0, "m")]
OnStale = Literal["fault", "last"]


class HeightMap:
    """What the blocks have in common: the states, and the wait for news.

    Args:
        context: with states and platform.
        size: edge of the map in [m].
        resolution: edge of a cell in [m].
        stale: so long no news may come, in [s].
        on_stale: then a `fault`, or go on with the `last` map.
    """

    name: str
    endless = outside = True

    def __init__(
        self, context: BuildContext, size: float, resolution: float, stale: float, on_stale: OnStale
    ) -> None:
        states, cells = context.states, round(size / resolution)
        if states.num_robots is not None:
            raise UniconError(f"{self.name}: it is of one robot; leave num_robots out")
        if cells > MOST_CELLS:
            text = f"size / resolution is {cells}, at most {MOST_CELLS}; give a larger resolution"
            raise UniconError(f"{self.name}: {text}")
        self.writes = tuple(self.declares(size=size, resolution=resolution))
        self._out = [states[name] for name in self.writes]
        self._pose = states["base_pos_w"], states["base_quat"]
        self._stale = stale if on_stale == "fault" else math.inf
        self._cells, self._reach, self._fresh = cells, 0.5 * size, math.inf

    @staticmethod
    def declares(*, size: float = 4.0, resolution: float = 0.05, **_: Any) -> dict[str, StateSpec]:
        """Return the states of the map."""
        return height_map_states(round(size / resolution), resolution)

    def _write(self, *values: Array) -> None:
        for out, value in zip(self._out, values):
            out[...] = value

    def _wait(self, here: float, what: str, why: str = "") -> None:
        """Raise a Fault if there was no news for too long; the wait begins with the first tick."""
        self._fresh = min(self._fresh, here)
        if here - self._fresh > self._stale:
            raise Fault(
                f"{self.name}: no {what} for {self._stale:g} s{why}; see to what sends it, or give "
                "on_stale: last"
            )


class ElevationMap(HeightMap):
    """Writes the states of a height map, see `unicon_core/terrain/height_map.py`.

    Args:
        context: says states, platform and the blocks before this one.
        handle: state with the number of the newest frame: depths (32FC1) or a cloud of a block
            that is listed before this one.
        position: of the sensor's frame in the base's.
        quat: sensor's frame to the base's, wxyz; that of a camera that looks along x unless given.
        fovy: vertical field of view of depths; a cloud needs none.
        size: edge of the map, the robot amid.
        resolution: edge of a cell.
        decay: a cell that was measured longer ago counts as not measured.
        highest: points that are higher above the base's origin are no ground.
        body_radius: points that are nearer to the base, seen from above, are the robot's own.
        base_height: of the base above the ground, for cells that near which were never measured;
            None: these are filled as other holes.
        points: at most so many of a frame are taken, evenly.
        stale: so long no frame may come.
        on_stale: then a `fault`, or go on with the `last` map.

    Raises:
        UniconError: no block before fills the handle, or frames of another kind.
        Fault: no frame came for too long.
    """

    name = "elevation_map"

    def __init__(
        self,
        context: BuildContext,
        *,
        handle: str = "camera_handle",
        position: Point = (0.0, 0.0, 0.0),
        quat: Quat = OPTICAL,
        fovy: Annotated[float, Within(1.0, 170.0, "°")] = 60.0,
        size: Size = 4.0,
        resolution: Resolution = 0.05,
        decay: Annotated[float, positive(unit="s")] = 30.0,
        highest: Annotated[float, Within(-2.0, 5.0, "m")] = 0.5,
        body_radius: Annotated[float, Within(0.0, 5.0, "m")] = 0.5,
        base_height: Annotated[float | None, Within(0.0, 5.0, "m")] = None,
        points: Annotated[int, Within(10, 100_000)] = 3000,
        stale: Stale = 2.0,
        on_stale: OnStale = "fault",
    ) -> None:
        super().__init__(context, size, resolution, stale, on_stale)
        self._frames, self._dry = Frames(context, handle, self.name), context.dry
        self.reads = ("base_pos_w", "base_quat", "stamp_ns", handle)
        if context.dry:
            return
        message = self._frames.message
        if message is None or message.type not in (IMAGE, CLOUD) or message.dtype == "|u1":
            raise UniconError(f"elevation_map: {handle!r} has no depths; take a depth or a cloud")
        self._turn, self._origin = rotation(np.array(quat)), np.array(position)[:, None]
        self._highest, self._radius, self._base_height = highest, body_radius, base_height
        self._grid = ElevationGrid(self._cells, resolution, decay, body_radius)
        kept = max(round(KEPT / context.period), 1)
        self._stamps, self._poses = np.zeros(kept, np.int64), np.full((kept, 7), math.nan)
        self._next = 0
        shape = message.shape
        self._every = -(-math.prod(shape[:2] if len(shape) > 1 else shape) // points)
        self._rays: Array | None = None
        if message.type == IMAGE:
            focal = 0.5 * shape[0] / math.tan(0.5 * math.radians(fovy))
            middle = 0.5 * (shape[1] - 1), 0.5 * (shape[0] - 1)
            self._rays = rays(shape[1], shape[0], Intrinsics(focal, focal, *middle))

    def __call__(self) -> None:
        """Keep the pose, and take a new frame into the map."""
        if self._dry:
            return
        here, pose = time.monotonic(), self._poses[self._next]
        self._stamps[self._next] = self._frames.now()
        pose[:3], pose[3:] = self._pose
        if (newest := self._frames.newest()) is not None:
            points = self._points(newest[0])
            if self._frames.whole() and self._take(points, newest[1]):
                self._fresh = here
        self._next = (self._next + 1) % len(self._stamps)
        self._wait(here, f"frame of {self.reads[-1]!r}")

    def _points(self, data: Array) -> Array:
        """Return points in the sensor's frame in [m], shape (3, k); NaN is no measurement."""
        if data.dtype.names is not None:
            return np.stack([data[axis][:: self._every] for axis in "xyz"])
        if self._rays is None:
            return data.reshape(-1, 3)[:: self._every].T
        depths = data.reshape(-1)[:: self._every]
        return self._rays.reshape(-1, 3)[:: self._every].T * depths

    def _take(self, points: Array, stamp: int) -> bool:
        """Put points into the map by the pose at their time; False where that is not known."""
        apart = np.abs(self._stamps - stamp)
        nearest = int(apart.argmin())
        pose, now = self._poses[nearest], self._poses[self._next]
        if apart[nearest] > APART * 1e9 or not np.isfinite((pose, now)).all():
            return False
        there = rotation(pose[3:]) @ (self._turn @ points + self._origin) + pose[:3, None]
        away = np.hypot(there[0] - pose[0], there[1] - pose[1])
        taken = (away >= self._radius) & (there[2] < pose[2] + self._highest)  # NaN is neither
        self._grid.move(now[:2])
        self._grid.add(there[:, taken], stamp * 1e-9)
        under = math.nan if self._base_height is None else now[2] - self._base_height
        self._write(*self._grid.measured(stamp * 1e-9, under))
        return True


GRID_MAP = "grid_map_msgs/msg/GridMap"
LEVEL = 1e-3
"""Of a quaternion's x, y and z: a map with more is turned in its frame."""
NUDGE = 1e-6
"""In [m]: middles of cells on a border of ours fall on one side of it."""


class GridMapDecoder(Decoder):
    """Takes one layer of GridMaps.

    Args:
        spec: the topic.
        layer: whose numbers are heights in [m].
        frame: that a message has to be in.
        clock: simulated time in [ns]; None: stamps are on the wall clock.
        stale: age of a message that is refused, in [s].

    Attributes:
        x, y: middles of the last message's cells in [m], shapes (m,) and (k,).
        heights: in [m], shape (k, m); not finite where they are not known.
        age: of the last message when it came, in [s]; 0 where it has no stamp.
    """

    x: Array
    y: Array
    heights: Array
    age: float

    def __init__(
        self, spec: SubscribeSpec, layer: str, frame: str, clock: Array | None, stale: float
    ) -> None:
        super().__init__(spec, spec.messages.struct(GRID_MAP), [])
        self._layer, self._frame, self._clock, self._stale = layer, frame, clock, stale
        spec.messages.store.get_msgdef(GRID_MAP)  # generates code: 13 ms that no tick has to take

    def read(self, raw: bytes) -> None:
        """Take a message.

        Raises:
            Rejected: it is no GridMap, old, in another frame, or contradictory.
        """
        try:
            said = self.spec.messages.store.deserialize_cdr(raw, GRID_MAP)
            layers = dict(zip(said.layers, said.data, strict=True))
        except Exception as error:  # whatever such bytes make of the types
            raise Rejected(f"it is no GridMap: {one_line(error)}") from None
        head, info, place = said.header, said.info, said.info.pose.position
        turn = [abs(getattr(info.pose.orientation, axis)) for axis in "xyz"]
        figures = np.array([info.resolution, info.length_x, info.length_y, place.x, place.y, *turn])
        stamp = head.stamp.sec * 10**9 + head.stamp.nanosec
        now = time.time_ns() if self._clock is None else int(self._clock)
        self.age = age = abs(now - stamp) * 1e-9 if stamp else 0.0
        if head.frame_id != self._frame:
            raise Rejected(
                f"it is in frame {head.frame_id!r}; give frame, if base_pos_w is in that"
            )
        if age > self._stale:
            raise Rejected(
                f"its stamp is {age:.3g} s from now; see to clocks (use_sim_time), stale"
            )
        if not (np.isfinite(figures).all() and figures[0] > 0.0 and max(turn) <= LEVEL):
            text = "finite resolution above 0, lengths, x and y, and no turn"
            raise Rejected(f"its info is {figures.tolist()}; send {text}")
        if self._layer not in layers:
            raise Rejected(f"it has no layer {self._layer!r}; {alternatives(self._layer, layers)}")
        data = layers[self._layer]
        size = np.round(figures[1:3] / figures[0])
        columns, rows = size.tolist()
        sizes = {each.label: each.size for each in data.layout.dim}
        begin = said.outer_start_index, said.inner_start_index
        wanted = {"row_index": columns, "column_index": rows}
        if sizes != wanted or data.data.size != columns * rows or not (begin < size).all():
            there = f"{data.data.size} numbers for {sizes} from {begin} on"
            raise Rejected(f"layer {self._layer!r} has {there}; its lengths make {wanted}")
        heights = data.data.reshape(list(sizes.values()))
        self.heights = heights if next(iter(sizes)) == "column_index" else heights.T
        self.x, self.y = (
            corner + NUDGE - figures[0] * ((np.arange(n) - first) % n + 0.5)
            for corner, n, first in zip(figures[3:5] + 0.5 * figures[0] * size, size, begin)
        )

    def points(self, place: Array, reach: float) -> Array:
        """Return the known middles of cells up to `reach` in [m] from x and y, shape (3, n)."""
        x, y = (np.abs(at - middle) <= reach for at, middle in zip((self.x, self.y), place))
        cells = *np.meshgrid(self.x[x], self.y[y]), self.heights[np.ix_(y, x)]
        points = np.stack(cells).reshape(3, -1)
        return points[:, np.isfinite(points[2])]


class GridMap(HeightMap):
    """Writes the states of a height map from maps on a ROS topic (grid_map_msgs/msg/GridMap).

    Args:
        context: says states and platform.
        topic: of the maps.
        layer: whose numbers are heights in [m].
        frame: that the maps are in, which has to be that of `base_pos_w`; they are not turned.
        latched: the maps are reliable and the last one waits for late subscribers.
        size: edge of the map that is kept, the robot amid.
        resolution: edge of a cell, best that of the maps; in each the highest of theirs counts.
        stale: so long no map may come, nor be old when it comes.
        on_stale: then a `fault`, or go on with the `last` map, however old.

    Raises:
        UniconError: there are several robots, ROS is absent, or the middleware cannot be polled.
        Fault: no map came for too long.
    """

    name = "grid_map"

    def __init__(
        self,
        context: BuildContext,
        *,
        topic: RosName = "elevation_map",
        layer: str = "elevation",
        frame: str = "odom",
        latched: bool = False,
        size: Size = 4.0,
        resolution: Resolution = 0.05,
        stale: Stale = 2.0,
        on_stale: OnStale = "fault",
    ) -> None:
        super().__init__(context, size, resolution, stale, on_stale)
        self.reads = ("base_pos_w", "stamp_ns")
        self._topic: TopicIn | None = None
        if context.dry:
            return
        qos, group = LATCHED if latched else LATEST, compat.polled_group()
        spec = SubscribeSpec(topic, GRID_MAP, (), shared_messages(), qos=qos)
        message = message_class(spec)
        self._grid = ElevationGrid(self._cells, resolution, 0.0)
        platform = context.platform
        simulated = platform is not None and platform.facts.simulated
        clock = context.states["stamp_ns"] if simulated else None
        maps = self._maps = GridMapDecoder(spec, layer, frame, clock, self._stale)
        own = self._own = OwnNode("unicon_grid_map", None, ())
        self._topic = TopicIn(own.node, maps, message, False, group, context.tell)
        if not self._topic.polled:
            self.close()
            raise UniconError("grid_map: this rclpy cannot be polled; use Humble, Jazzy or Kilted")
        calm_middleware_threads()

    def __call__(self) -> None:
        """Take a new map, and keep the robot amid."""
        topic = self._topic
        if topic is None:
            return
        here, base, received = time.monotonic(), self._pose[0][:2], self._maps.received
        topic.poll()
        new = self._maps.received > received
        if np.isfinite(base).all() and (
            new or np.abs(base - self._out[2]).max() > 0.5 * self._reach
        ):
            self._fresh = here - self._maps.age if new else self._fresh
            self._grid.move(base)
            self._grid.add(self._maps.points(base, self._reach), self._maps.received)
            self._write(*self._grid.measured(self._maps.received))
        self._wait(here, f"map on topic {topic.topic!r}", topic.why and f" (the last: {topic.why})")

    def close(self) -> None:
        """Leave the topic."""
        if self._topic is not None:
            self._topic.close()
            self._own.close()
