"""Command bounds: the largest velocity command that the flow ever sees, for the workflow builder.

Whoever gives it (`commands:`, a topic, a block of one's own), the last thing before a reader is a
clip: to the `command_ranges` of the controllers that read it, else of the robot file, else to
`CAUTIOUS`. Zero is always allowed: it is what silence commands.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from unicon_base import TextSink
from unicon_base.arrays import Array, Float32
from unicon_core.policies.controller import ControllerContract
from unicon_core.robots import Robot

COMMAND = "velocity_command"

CAUTIOUS = {"vx": 1.0, "vy": 0.5, "wz": 1.0}
"""Largest magnitudes where nobody says any, [m/s], [m/s], [rad/s]."""

CALM = 2.0
"""Time within the bounds after which an episode is over, [s]: each is told once."""

_POLICY_KEYS = {"vx": "lin_vel_x", "vy": "lin_vel_y", "wz": "ang_vel_z"}
_UNITS = {"vx": "m/s", "vy": "m/s", "wz": "rad/s"}


@dataclass(frozen=True)
class CommandBound:
    """What one element of the command is held to.

    Attributes:
        axis: `vx`, `vy` or `wz`.
        low, high: in [m/s] or [rad/s]; zero lies between them.
        sources: who says low and high.
        given: whether a policy or the robot file says them.
    """

    axis: str
    low: float
    high: float
    sources: tuple[str, str]
    given: bool

    @property
    def unit(self) -> str:
        """Its unit."""
        return _UNITS[self.axis]


def command_bounds(
    readers: Sequence[tuple[str, ControllerContract]], robot: Robot
) -> tuple[CommandBound, ...]:
    """Return the bounds of vx, vy and wz; of several controllers the tightest.

    Args:
        readers: the controllers in use that read the command, with what to call them.
        robot: what its file says counts for controllers that say nothing.
    """
    bounds = []
    for axis, cautious in CAUTIOUS.items():
        said = f"neither policy nor {robot.path.name} has command_ranges"
        fallback = (-cautious, cautious), said, False
        if axis in robot.command_ranges:
            fallback = robot.command_ranges[axis], f"command_ranges of robot {robot.name}", True
        found: list[tuple[tuple[float, float], str, bool]] = []
        for label, contract in readers:
            pair = contract.command_ranges.get(_POLICY_KEYS[axis])
            if pair is None or not all(map(math.isfinite, pair)):
                found.append(fallback)
            else:
                found.append((pair, f"command_ranges of {label}", True))
        found = found or [fallback]
        low = max(found, key=lambda each: each[0][0])
        high = min(found, key=lambda each: each[0][1])
        lowest, highest = float(np.float32(low[0][0])), float(np.float32(high[0][1]))
        ends, sources = (min(lowest, 0.0), max(highest, 0.0)), (low[1], high[1])
        bounds.append(CommandBound(axis, *ends, sources, low[2] and high[2]))
    return tuple(bounds)


class CommandBounds:
    """The tick: clips in place. What is not finite commands nothing that is known: it becomes zero.

    Args:
        command: vx, vy [m/s], wz [rad/s], shape (..., 3).
        bounds: of vx, vy and wz.
        tick: number of the present tick.
        period: of a tick in [s].
        warn: gets one line for each episode.
    """

    memory = ("_last",)

    name = "command bounds"
    amends = (COMMAND,)
    endless = True

    def __init__(
        self,
        command: Float32,
        bounds: tuple[CommandBound, ...],
        tick: Array,
        period: float,
        warn: TextSink,
    ) -> None:
        self._rows = command.reshape(-1, 3)
        self._first = self._rows[0]
        self._bounds, self._tick, self._warn = bounds, tick, warn
        self._calm = max(1, round(CALM / period))
        self._low = np.array([each.low for each in bounds], np.float32)
        self._high = np.array([each.high for each in bounds], np.float32)
        (self._x0, self._x1), (self._y0, self._y1), (self._z0, self._z1) = (
            (each.low, each.high) for each in bounds
        )
        self._last: dict[tuple[str, bool], int] = {}
        if len(self._rows) > 1:
            self.warm_up = self.within = self._all_within  # type: ignore[method-assign]

    def __call__(self) -> None:
        if not self.within():
            self._amend()

    def within(self) -> bool:
        """Return whether all is within its bounds: 0.3 µs, of Python's own numbers."""
        command: list[float] = self._first.tolist()
        x, y, z = command
        return self._x0 <= x <= self._x1 and self._y0 <= y <= self._y1 and self._z0 <= z <= self._z1

    warm_up = within

    def _all_within(self) -> bool:
        rows = self._rows
        return bool((rows >= self._low).all() and (rows <= self._high).all())

    def _amend(self) -> None:
        for row in self._rows:
            values = row.tolist()
            finite = all(map(math.isfinite, values))
            for bound, value in zip(self._bounds, values):
                beyond = finite and not bound.low <= value <= bound.high
                if beyond or not math.isfinite(value):
                    self._tell(bound, value)
            if finite:
                np.maximum(row, self._low, out=row)
                np.minimum(row, self._high, out=row)
            else:
                row[...] = 0.0

    def _tell(self, bound: CommandBound, value: float) -> None:
        tick = int(self._tick.flat[0])  # of a batch all have the same
        key = bound.axis, math.isfinite(value)
        since = tick - self._last.get(key, tick + 1)
        self._last[key] = tick
        if 0 <= since <= self._calm:
            return
        told = f"{COMMAND} {bound.axis} is {value:g}"
        if not key[1]:
            self._warn(f"{told}: the whole command is zero")
            return
        low = value < bound.low
        limit = bound.low if low else bound.high
        self._warn(f"{told}, held to {limit:g} {bound.unit} ({bound.sources[not low]})")
