"""Keeper: a few states of every tick of a run in a room that does not grow, for pictures of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from unicon_base.arrays import Array
from unicon_core.drawing import require
from unicon_core.flow import Block, Stage
from unicon_ros.attachments import Attachment
from unicon_ros.bridge.bindings import told_states

if TYPE_CHECKING:
    from unicon_core.runtime import Runner
    from unicon_core.runtime.phases import Phase
    from unicon_core.workflow import HookBlocks, Program

STATES = (
    *("base_pos_w", "base_lin_vel", "base_ang_vel", "projected_gravity", "velocity_command"),
    *("joint_pos", "joint_pos_target", "joint_vel", "joint_effort"),
)
ROWS = 8192
"""Of what is kept: 164 s at 50 Hz tick by tick. Then a row stands for two ticks, four, …"""


class Keeper(Attachment):
    """Keeps states of all ticks; of long runs the first, lowest and highest values of stretches.

    Args:
        what: wants to draw them, such as `--picture`.

    Attributes:
        stride: ticks that a row stands for.
        robot: whose states they are.
        period: of the ticks in [s].
        ticks: that were kept, of all phases.
        phases: (number of the tick at which it began, phase), in order.
        told: the states that the platform or a block writes.
        statistics: of the run, once it is attached.

    Raises:
        MissingDependencyError: matplotlib is not installed: said before the run, not after it.
    """

    def __init__(self, what: str) -> None:
        require(what)
        self.stride = 1
        self.phases: list[tuple[int, Phase]] = []
        self.told: frozenset[str] = frozenset()
        self._columns: dict[str, slice] = {}
        self.ticks = self._row = self._in_row = 0
        self._runner: Runner | None = None
        self._phase: Phase | None = None

    def hook(self, program: Program) -> HookBlocks:
        """Return the block that keeps the states."""
        states = program.states
        self.robot, self.period, start = program.robot, program.period, 0
        views = {name: states[name] for name in STATES if name in states}
        if states.num_robots is not None:
            views = {name: view[0] for name, view in views.items()}
        for name, view in views.items():
            self._columns[name] = slice(start, start + view.size)
            start += view.size
        # Written once, so that no page of it is new to a tick: first, lowest, highest.
        self._rows = np.full((ROWS, 3, start), np.nan, np.float32)
        now = np.zeros(start, np.float32)
        places = [(now[self._columns[name]], view) for name, view in views.items()]

        def keep() -> None:
            for place, view in places:
                place[...] = view
            row = self._rows[self._row]
            if self._in_row:
                np.minimum(row[1], now, out=row[1])
                np.maximum(row[2], now, out=row[2])
            else:
                row[...] = now
            runner = self._runner
            if runner is not None and runner.phase is not self._phase:
                self._phase = runner.phase
                self.phases.append((self.ticks, self._phase))
            self.ticks += 1
            self._in_row += 1
            if self._in_row == self.stride:
                self._in_row = 0
                self._row += 1
                if self._row == ROWS:
                    self._halve()

        return {Stage.OBSERVE: [Block("kept", keep, reads=tuple(views))]}

    def attach(self, runner: Runner) -> None:
        """Get to know the runner, whose phases are kept, and who writes what."""
        self._runner, self.statistics = runner, runner.statistics
        self.told = told_states(runner.program)

    def _halve(self) -> None:
        """Let each row stand for twice as many ticks; a millisecond, once in that many ticks."""
        pairs = self._rows.reshape(ROWS // 2, 2, *self._rows.shape[1:])
        half = self._rows[: ROWS // 2]
        half[:, 0] = pairs[:, 0, 0]
        half[:, 1] = np.minimum(pairs[:, 0, 1], pairs[:, 1, 1])
        half[:, 2] = np.maximum(pairs[:, 0, 2], pairs[:, 1, 2])
        self.stride *= 2
        self._row = ROWS // 2

    # -- for the pictures -----------------------------------------------------------------------

    @property
    def paced(self) -> bool:
        """Whether the clock paced the ticks, so that they may be late."""
        return self._runner is not None and self._runner.options.speed == "real"

    @property
    def begin(self) -> int:
        """Number of the kept tick with which the flow began; time counts from there."""
        return next((tick for tick, phase in self.phases if phase.value == "run"), 0)

    def spans(self) -> list[tuple[str, int, int]]:
        """Return each phase with the numbers of its first tick and of the one behind its last."""
        ends = [*(tick for tick, _ in self.phases[1:]), self.ticks]
        return [(phase.value, begin, end) for (begin, phase), end in zip(self.phases, ends)]

    def beside_the_run(self) -> list[tuple[float, float]]:
        """Return from when to when another phase than the run was kept, in [s]."""
        return [
            ((begin - self.begin) * self.period, (end - self.begin) * self.period)
            for phase, begin, end in self.spans()
            if phase != "run"
        ]

    def time(self) -> Array:
        """Return when each row begins in [s], shape (rows,)."""
        ticks = np.arange(self._used, dtype=np.float64) * self.stride
        return (ticks - self.begin) * self.period

    def first(self, name: str) -> Array:
        """Return the first values of a state in each row, shape (rows, elements)."""
        return self._of(name, 0)

    def reached(self, name: str) -> tuple[Array, Array]:
        """Return the lowest and the highest value of each element in the run, shape (elements,)."""
        return np.fmin.reduce(self._of(name, 1), axis=0), np.fmax.reduce(self._of(name, 2), axis=0)

    def largest(self, name: str) -> Array:
        """Return the largest size of each element in the run, shape (elements,)."""
        low, high = self.reached(name)
        return np.fmax(np.abs(low), np.abs(high))

    def curve(self, name: str) -> tuple[Array, Array]:
        """Return times in [s] and values of a state to draw, no peak lost."""
        time = self.time()
        if self.stride == 1:
            return time, self.first(name)
        both = np.stack([self._of(name, 1), self._of(name, 2)], axis=1)
        return np.repeat(time, 2), both.reshape(-1, both.shape[2])

    def has(self, name: str) -> bool:
        """Return whether somebody tells a state, and it is a number in some tick."""
        return (
            name in self._columns
            and name in self.told
            and bool(np.isfinite(self.first(name)).any())
        )

    def unfit(self) -> dict[str, float]:
        """Return states that were not a number for a while: when first, in [s] of the run."""
        found = {}
        for name in self._columns:
            bad = ~np.isfinite(self._of(name, 1) + self._of(name, 2)).all(axis=1)
            if self.has(name) and bad.any():
                found[name] = float(self.time()[bad.argmax()])
        return found

    def _of(self, name: str, which: int) -> Array:
        """Return the first (0), lowest (1) or highest (2) values of a state in each row."""
        return self._rows[: self._used, which, self._columns[name]]

    @property
    def _used(self) -> int:
        return self._row + (self._in_row > 0)
