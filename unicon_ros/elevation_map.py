"""Block `elevation_map`, which writes a height map around the robot, and what `grid_map` shares.

    deferred:
      - realsense: {cloud: true}
      - elevation_map: {handle: realsense_cloud_handle, position: [0.3, 0.0, 0.1]}

`elevation_map` takes frames of a camera or a scanner. Each new one is turned into the world by the
pose that the base had at the frame's time. What it costs is bounded by `points`; ticks without a
new frame only keep the pose. Behind `send` it delays no command: a policy sees the map in the next
tick. Replays give it again from records.
"""

from __future__ import annotations

import math
import time
from typing import Annotated, Any, Literal

import numpy as np

from unicon_base import Fault, UniconError
from unicon_base.arrays import Array
from unicon_base.schema.marks import Point, Quat, Within, positive
from unicon_core.models.camera import Intrinsics
from unicon_core.platforms.kit.base import rotation
from unicon_core.policies.perception import Frames
from unicon_core.states import StateSpec
from unicon_core.terrain.height_map import ElevationGrid, height_map_states
from unicon_core.workflow.autowire import BuildContext
from unicon_ros.bridge.images import CLOUD, IMAGE, rays

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
Stale = Annotated[float, positive(10.0, "s")]
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
