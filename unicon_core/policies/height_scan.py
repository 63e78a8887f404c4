"""Height scan of a policy: the key `height_scan` of a contract, and what fills the state.

The layout is that of Isaac Lab (isaac-sim/IsaacLab, `sensors/ray_caster/patterns/patterns.py`,
`grid_pattern`, and `envs/mdp/observations.py`, `height_scan`, before its offset of 0.5 m): with
ordering `xy` x varies fastest, both ends are points, and a value is the height of the base above
the ground. mujocolab/mjlab (`sensor/raycast_sensor.py`, `GridPatternCfg`) has the same order. Both
turn the grid by the yaw of the base in their velocity tasks (`ray_alignment="yaw"`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np

from unicon_base import AnyDict
from unicon_base.arrays import Float64
from unicon_base.schema.marks import Metres, Within, positive
from unicon_base.schema.types import Here
from unicon_core.policies.controller import PackedStates
from unicon_core.states import StateSpec
from unicon_core.terrain.height_map import Heights

HEIGHT_SCAN = "height_scan"
MOST_POINTS = 10_000
_WHOLE = 1e-4  # of a step: what float32 and decimals leave


@dataclass(frozen=True)
class HeightScanSpec:
    """The grid of points around the base at which a policy sees the ground.

    Attributes:
        size: from the first to the last point along x and y.
        resolution: between two points.
        offset: of the grid's middle from the base's origin.
        frame: the grid turns with the base's `yaw`.
        order: `xy`: x varies fastest, as in Isaac Lab; `yx`: y does.
    """

    size: tuple[Annotated[float, Within(0.0, 10.0, "m")], Annotated[float, Within(0.0, 10.0, "m")]]
    resolution: Annotated[float, positive(10.0, "m")]
    offset: tuple[Metres, Metres] = (0.0, 0.0)
    frame: Literal["yaw"] = "yaw"
    order: Literal["xy", "yx"] = "xy"

    @staticmethod
    def between(found: AnyDict, here: Here) -> None:
        """Note a size that is no multiple of the resolution, and too many points."""
        size, step = found.get("size"), found.get("resolution")
        if size is None or step is None:
            return
        steps = [edge / step for edge in size]
        for edge, count in zip(size, steps):
            if abs(count - round(count)) > _WHOLE * max(count, 1.0):
                here.value(
                    f"has {edge:g} m, which is no multiple of the resolution of {step:g} m; the "
                    f"nearest is {round(count) * step:g} m",
                    "size",
                )
        total = math.prod(round(count) + 1 for count in steps)
        if total > MOST_POINTS:
            here.value(
                f"makes {total} points, at most {MOST_POINTS}; give a larger one", "resolution"
            )

    @property
    def counts(self) -> tuple[int, int]:
        """Number of points along x and along y."""
        x, y = (round(edge / self.resolution) + 1 for edge in self.size)
        return x, y

    def points(self) -> Float64:
        """Return x and y from the base's origin in the base's heading in [m], shape (2, n)."""
        x, y = (
            middle + np.linspace(-edge / 2, edge / 2, count)
            for middle, edge, count in zip(self.offset, self.size, self.counts)
        )
        grid = np.meshgrid(x, y, indexing="xy" if self.order == "xy" else "ij")
        return np.stack(grid).reshape(2, -1)

    def state(self) -> StateSpec:
        """Return the specification of the state `height_scan`, shape (n,)."""
        x, y = self.counts
        text = f"base's height above the ground at {x} x {y} points, {self.order} order"
        return StateSpec((x * y,), "float32", "m", "yaw", (), text)

    def __str__(self) -> str:
        x, y = self.counts
        middle = f"middle at {list(self.offset)} m of the base's {self.frame}"
        return f"{x} x {y} points, {self.resolution:g} m apart, {middle}, order {self.order}"


class HeightScan:
    """Writes `height_scan` each tick of a policy, before its observation.

    Each value is the height of the base's origin above the ground below a point of the grid in
    [m]. A pose that is not finite makes all of it NaN, which the policy refuses as a fault. The yaw
    of a base that lies on its back or stands on its nose is that of its x axis on the ground, as
    `yaw_quat` of Isaac Lab has it.

    Args:
        spec: of the contract.
        states: with `height_scan`, `base_pos_w` and `base_quat`.
        ground: heights of the ground under the base.
    """

    memory = ()

    writes = (HEIGHT_SCAN,)

    def __init__(self, spec: HeightScanSpec, states: PackedStates, ground: Heights) -> None:
        rows = states.num_robots or 1
        self._pos, self._quat = (
            states[name].reshape(rows, size) for name, size in (("base_pos_w", 3), ("base_quat", 4))
        )
        self._scan = states[HEIGHT_SCAN].reshape(rows, -1)
        self._x, self._y = spec.points()
        self._points = np.empty((2, self._x.size))
        self._ground = ground
        self.reads = ("base_pos_w", "base_quat", *getattr(ground, "reads", ()))

    def __call__(self) -> None:
        """Write the scan of each robot."""
        for pos, quat, scan in zip(self._pos, self._quat, self._scan):
            x, y, z = pos.tolist()
            w, i, j, k = quat.tolist()
            cosine, sine = 1.0 - 2.0 * (j * j + k * k), 2.0 * (w * k + i * j)
            length = math.hypot(cosine, sine)
            if not math.isfinite(x + y + z + length):
                scan[...] = math.nan
                continue
            cosine, sine = (cosine / length, sine / length) if length else (1.0, 0.0)
            # Sums of products, not a matrix product: the same bits on every machine.
            self._points[0] = cosine * self._x - sine * self._y + x
            self._points[1] = sine * self._x + cosine * self._y + y
            np.subtract(z, self._ground(self._points), out=scan, casting="same_kind")
