"""Blocks `velocity_command` and `drive`: a command that is constant, scheduled, or of sticks.

`drive` commands as long as a button is held where one is named.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated

import numpy as np

from unicon_base.errors import WorkflowError
from unicon_base.schema.marks import NotEmpty, Within, Write, positive
from unicon_core.blocks.controls.device import declares_controls
from unicon_core.blocks.postures import end_of, single
from unicon_core.bounds import BUTTONS, Button, Seconds
from unicon_core.flow.block import Reads, Writes

Twist = tuple[float, float, float]
Row = Annotated[tuple[Seconds, float, float, float], Write("[t, vx, vy, wz]")]
Pair = tuple[float, float]
Change = Annotated[float, positive()]


class VelocityCommand:
    """Write vx, vy in [m/s] and wz in [rad/s].

    Args:
        constant: [vx, vy, wz].
        schedule: rows [t, vx, vy, wz] with rising t in [s] since entry; each holds until the next,
            zero before the first.
        ramp: largest change in [m/s², m/s², rad/s²], one number or three; None jumps.
        limits: [[lowest, highest], …] of vx, vy, wz.
        duration: in [s]; None never ends.

    Attributes:
        values: all commands, within the limits, shape (rows, 3).

    Raises:
        WorkflowError: an option does not fit.
    """

    memory = ("_tick", "_row")

    def __init__(
        self,
        velocity_command: Writes,
        *,
        period: float,
        constant: Annotated[Twist | None, Write("[vx, vy, wz]")] = None,
        schedule: Annotated[Sequence[Row], NotEmpty] | None = None,
        ramp: Change | tuple[Change, Change, Change] | None = None,
        limits: Annotated[
            tuple[Pair, Pair, Pair] | None, Write("[[lowest, highest]] of vx, vy and wz")
        ] = None,
        duration: Seconds | None = None,
    ) -> None:
        if (constant is None) == (schedule is None):
            raise WorkflowError(
                "give either constant: [vx, vy, wz] or schedule: [[t, vx, vy, wz], …]"
            )
        rows = np.array(schedule if constant is None else [(0.0, *constant)])
        times = rows[:, 0].tolist()
        if any(late <= early for early, late in pairwise(times)):
            raise WorkflowError(f"the schedule's times {times} do not rise; correct them")
        self.values = self._values = rows[:, 1:].astype(np.float32)
        if limits is not None:
            lower, upper = bounds = np.array(limits, np.float32).T
            if (lower > upper).any():
                raise WorkflowError(
                    f"limits are {bounds.T.tolist()}; give [[lowest, highest]] of vx, vy and wz"
                )
            np.clip(self._values, lower, upper, out=self._values)
        self._step = None if ramp is None else np.asarray(ramp, np.float32) * np.float32(period)
        self._starts = [round(t / period) for t in times]
        self._out = velocity_command
        self._ticks = end_of(duration, period)
        self.endless = duration is None
        self._change = np.zeros_like(velocity_command)
        self._zero = np.zeros(3, np.float32)
        self.reset()

    def __call__(self) -> bool:
        while self._row + 1 < len(self._starts) and self._tick >= self._starts[self._row + 1]:
            self._row += 1
        wanted = self._values[self._row] if self._row >= 0 else self._zero
        if self._step is None:
            self._out[...] = wanted
        else:
            np.subtract(wanted, self._out, out=self._change)
            np.clip(self._change, -self._step, self._step, out=self._change)
            self._out += self._change
        self._tick += 1
        return self._tick >= self._ticks

    def reset(self) -> None:
        """Begin the schedule anew."""
        self._tick = 0
        self._row = -1


Fast = Annotated[float, Within(0.0)]
FASTEST = (0.5, 0.3, 0.8)


class Drive:
    """Command by the left stick where to, by the right one how to turn.

    Nothing is commanded while the device is not heard.

    Args:
        speed: at full deflection, vx and vy in [m/s], wz in [rad/s].
        dead_zone: share of a stick's way that commands nothing.
        hold: button that has to be held, a dead-man switch; None for no such.

    Raises:
        WorkflowError: it is for several robots.
    """

    memory = ()

    endless = True
    declares = staticmethod(declares_controls)

    def __init__(
        self,
        sticks: Reads,
        buttons: Reads,
        controls_alive: Reads,
        velocity_command: Writes,
        *,
        speed: Annotated[tuple[Fast, Fast, Fast], Write("[vx, vy, wz] of 0 or more")] = FASTEST,
        dead_zone: Annotated[float, Within(0.0, 0.9)] = 0.1,
        hold: Button | None = None,
    ) -> None:
        single(sticks)
        self._sticks = sticks
        self._buttons = buttons
        self._alive = controls_alive
        self.buttons_used = () if hold is None else (hold,)
        self._held = None if hold is None else BUTTONS.index(hold)
        self._out = velocity_command
        self._dead_zone = dead_zone
        vx, vy, wz = speed
        # Right is positive on a stick, and left on the ground.
        self._axes = ((1, vx), (0, -vy), (2, -wz))

    def __call__(self) -> None:
        held = self._held is None or self._buttons[self._held]
        if not (held and self._alive):
            self._out[...] = 0.0
            return
        sticks = self._sticks.tolist()
        for element, (axis, factor) in enumerate(self._axes):
            self._out[..., element] = factor * self._steady(sticks[axis])

    def _steady(self, value: float) -> float:
        beyond = abs(value) - self._dead_zone
        if not beyond > 0.0:  # true for NaN
            return 0.0
        share = min(beyond / (1.0 - self._dead_zone), 1.0)
        return share if value > 0.0 else -share
