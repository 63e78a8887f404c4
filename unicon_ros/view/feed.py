"""Feed: copies each tick into a ring in shared memory, for a viewer's process; one copy a tick."""

from __future__ import annotations

import time
from collections.abc import Sequence
from types import CellType
from typing import TYPE_CHECKING

from unicon_core.handles import FrameRing
from unicon_core.runtime.phases import Phase
from unicon_core.workflow import Program
from unicon_ros.view.shown import HEAD

if TYPE_CHECKING:
    from unicon_core.runtime import Runner

__all__ = ["Feed"]

KEPT_S = 2.0
"""Of ticks in the ring, in [s]: a viewer that looks rarely still plots every one of them."""

FEWEST, LARGEST = 16, 32 << 20
"""Ticks in the ring at least, and its bytes at most beyond those."""

_NUMBERS = {phase: number for number, phase in enumerate(Phase)}


class Feed:
    """Deferred block: fills the ring.

    Args:
        program: whose states go into it.

    Attributes:
        ring: of ticks: `HEAD`, counters, states; None before `attach`.
        driving: 1 while a viewer drives.
        paused: 1 while the simulator stands still.
    """

    name = "view"
    endless = True

    def __init__(self, program: Program) -> None:
        self._states = program.states.buffer.data.cast("B")
        self._tick = program.states["tick"].reshape(-1)
        self._robots, self._period = program.states.num_robots or 1, program.period
        self.ring: FrameRing | None = None
        self.driving = self.paused = 0
        self._rows: list[memoryview] = []
        self._runner: Runner | None = None
        self._cells: Sequence[CellType] = ()
        self._stamps = memoryview(b"")

    def attach(self, runner: Runner, variables: Sequence[str]) -> FrameRing:
        """Make the ring, and get to know the runner.

        Args:
            runner: whose ticks it takes.
            variables: of the runner's graph that are the counters.
        """
        self._cells = runner.graph.cells(variables)
        size = HEAD.size + 8 * len(self._cells) + len(self._states)
        ticks = max(FEWEST, min(round(KEPT_S / self._period), LARGEST // size))
        ring = self.ring = FrameRing.create(size, ticks)
        self._rows = [memoryview(ring.slot(number).data) for number in range(ticks)]
        for row in self._rows:
            row[:] = bytes(size)  # no page is new to a tick
        self._stamps = memoryview(runner.graph.stamps.data)
        self._runner = runner
        return ring

    def __call__(self) -> None:
        """Copy the tick."""
        runner, ring = self._runner, self.ring
        if runner is None or ring is None:
            return
        now, begin = time.perf_counter_ns(), self._stamps[0]
        due = runner.next_due_ns - runner.period_ns
        late = begin - due if due > 0 else 0
        row = self._rows[ring.reserve()]
        HEAD.pack_into(
            row,
            0,
            *(int(self._tick[0]), time.time_ns(), _NUMBERS[runner.phase], self.paused, late),
            *(
                now - begin,
                runner.statistics.overruns,
                self.driving,
                self._robots,
                len(self._cells),
            ),
        )
        at = HEAD.size
        for cell in self._cells:
            row[at : at + 8] = cell.cell_contents.to_bytes(8, "little", signed=True)
            at += 8
        row[at:] = self._states
        ring.commit(now)

    def close(self) -> None:
        """Let the ring go; safe to call twice."""
        if self.ring is not None:
            self.ring.close()
