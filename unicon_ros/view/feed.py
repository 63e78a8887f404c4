"""Feed: copies each tick into a ring in shared memory, for a viewer's process; one copy a tick."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from unicon_core.handles import FrameRing
from unicon_core.runtime.phases import Phase
from unicon_ros.view.shown import WORDS

if TYPE_CHECKING:
    from unicon_core.runtime import Runner
    from unicon_ros.controls import Controls
    from unicon_ros.view.driver import Driver

__all__ = ["Feed"]

KEPT_S = 2.0
"""Of ticks in the ring, in [s]: a viewer that looks rarely still plots every one of them."""

FEWEST, LARGEST = 16, 32 << 20
"""Ticks in the ring at least, and its bytes at most beyond those."""


class Feed:
    """Fills the ring of a run.

    Args:
        runner: whose ticks it takes.
        variables: of the runner's graph that are the counters.

    Attributes:
        ring: of ticks: the words of `HEAD`, counters, states.
    """

    def __init__(self, runner: Runner, variables: Sequence[str]) -> None:
        self._runner, self._cells = runner, runner.graph.cells(variables)
        self._states = runner.program.states.buffer.data.cast("B")
        self._numbers = memoryview(np.zeros(WORDS + len(self._cells), np.int64).data)
        size = self._numbers.nbytes + len(self._states)
        ticks = max(FEWEST, min(round(KEPT_S / runner.program.period), LARGEST // size))
        self.ring = FrameRing.create(size, ticks)
        self.ring.touch()

    def filling(self, driver: Driver, controls: Controls) -> Callable[[], None]:
        """Return what copies a tick; all that it looks at is bound once.

        Args:
            driver: tells whether a viewer drives.
            controls: tell whether the simulator stands still.
        """
        runner, cells = self._runner, tuple(enumerate(self._cells, WORDS))
        states, numbers, put = self._states, self._numbers, self.ring.put
        program, statistics = runner.program, runner.statistics
        tick = memoryview(program.states["tick"].reshape(-1).data)
        rows = memoryview(statistics.rows.reshape(-1).data)
        capacity, width = statistics.rows.shape
        whole, now = numbers.cast("B"), time.perf_counter_ns
        phases, phase = {each: number for number, each in enumerate(Phase)}, None
        numbers[8], numbers[9] = program.states.num_robots or 1, len(cells)

        def fill() -> None:
            nonlocal phase
            if phase is not runner.phase:  # looked up when it changes: an enum's hash is slow
                phase = runner.phase
                numbers[2] = phases[phase]
            numbers[0] = tick[0]
            numbers[3] = controls.paused
            if count := statistics.count:  # of the tick before: this one has not ended
                row = (count - 1) % capacity * width
                numbers[4] = rows[row + 2] - rows[row]
                numbers[5] = rows[row + 1] - rows[row + 2]
                numbers[6] = statistics.overruns
            numbers[7] = driver.driving
            for place, cell in cells:
                numbers[place] = cell.cell_contents
            numbers[1] = at = now()
            put(at, whole, states)

        return fill

    def close(self) -> None:
        """Let the ring go; safe to call twice."""
        self.ring.close()
