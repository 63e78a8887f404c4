"""Block `velocity_command`: a constant or scheduled command where nobody else gives one."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from unicon_core.blocks.joint_command import LONGEST_S, ticks_of
from unicon_core.errors import WorkflowError
from unicon_core.flow.block import Writes


def velocity_command(
    velocity_command: Writes,
    *,
    period: float,
    constant: Sequence[float] | None = None,
    schedule: Sequence[Sequence[float]] | None = None,
    ramp: float | Sequence[float] | None = None,
    limits: Sequence[Sequence[float]] | None = None,
    duration: float | None = None,
) -> VelocityCommand:
    """Write vx, vy in [m/s] and wz in [rad/s].

    Args:
        constant: [vx, vy, wz].
        schedule: rows [t, vx, vy, wz] with rising t in [s] since entry; each holds until the next,
            zero before the first.
        ramp: largest change in [m/s², m/s², rad/s²], one number or three; None jumps.
        limits: [[lowest, highest], …] of vx, vy, wz.
        duration: in [s]; None never ends.

    Raises:
        WorkflowError: an option does not fit.
    """
    if (constant is None) == (schedule is None):
        raise WorkflowError("give either constant: [vx, vy, wz] or schedule: [[t, vx, vy, wz], …]")
    rows = [[0.0, *constant]] if constant is not None else [list(row) for row in schedule or ()]
    if not rows or any(len(row) != 4 for row in rows):
        wrong = next((row for row in rows if len(row) != 4), [])
        shown = wrong[1:] if constant is not None else wrong
        raise WorkflowError(
            f"{shown} is not a command; give [vx, vy, wz], with t in front in a row"
        )
    times = [float(row[0]) for row in rows]
    if any(late <= early for early, late in pairwise(times)) or not (
        times[0] >= 0.0 and times[-1] <= LONGEST_S
    ):
        raise WorkflowError(
            f"the schedule's times {times} do not rise from 0 to {LONGEST_S:g} s; correct them"
        )
    values = np.array([row[1:] for row in rows], np.float32)
    if limits is not None:
        bounds = np.array(limits, np.float32)
        if bounds.shape != (3, 2) or (bounds[:, 0] > bounds[:, 1]).any():
            raise WorkflowError(f"limits are {limits}; give [[lowest, highest]] of vx, vy and wz")
        np.clip(values, bounds[:, 0], bounds[:, 1], out=values)
    step = None
    if ramp is not None:
        step = np.broadcast_to(np.asarray(ramp, np.float32) * np.float32(period), (3,)).copy()
        if not (step > 0.0).all():
            raise WorkflowError(f"ramp is {ramp}; give numbers above 0 in [m/s², m/s², rad/s²]")
    starts = [round(t / period) for t in times]
    return VelocityCommand(
        velocity_command, starts, values, step, ticks_of(duration, period, "duration")
    )


class VelocityCommand:
    """The tick of `velocity_command`."""

    memory = ("_tick", "_row")

    def __init__(
        self,
        out: NDArray[np.float32],
        starts: list[int],
        values: NDArray[np.float32],
        step: NDArray[np.float32] | None,
        ticks: int | None,
    ) -> None:
        self._out, self._starts, self._values, self._step = out, starts, values, step
        self._ticks, self.endless = ticks, ticks is None
        self._change = np.zeros_like(out)
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
        return self._ticks is not None and self._tick >= self._ticks

    def reset(self) -> None:
        """Begin the schedule anew."""
        self._tick, self._row = 0, -1
