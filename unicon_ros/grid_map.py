"""Block `grid_map`, which writes a height map around the robot from the maps on a ROS topic."""

from __future__ import annotations

import time

import numpy as np

from unicon_base import UniconError, alternatives, one_line
from unicon_base.arrays import Array
from unicon_core.terrain.height_map import ElevationGrid
from unicon_core.workflow.autowire import BuildContext
from unicon_msgs_map import Decoder, SubscribeSpec
from unicon_msgs_map.codec.careful import Rejected
from unicon_msgs_map.layout.messages import shared_messages
from unicon_msgs_map.spec import RosName
from unicon_ros import compat
from unicon_ros.bridge.map_fit import message_class
from unicon_ros.bridge.own_node import OwnNode, calm_middleware_threads
from unicon_ros.bridge.qos import LATCHED, LATEST
from unicon_ros.bridge.topics import TopicIn
from unicon_ros.elevation_map import HeightMap, OnStale, Resolution, Size, Stale

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
