"""Detail: which ticks stamp each of their blocks, for the ticker.

Reading the clock takes as long as two blocks that do nothing: in a tick of 100 µs with 15 blocks
that is 1 %, and each tick has its detail; a tick of 5 µs with 60 blocks would take twice as long.
"""

from __future__ import annotations

import time

import numpy as np

from unicon_core.flow import CompiledGraph
from unicon_core.runtime.statistics import TickStatistics

LEARN = 256
"""Ticks with all stamps, of which it learns how long a tick takes."""
SHARE = 0.1
"""The largest part of a tick that its stamps may take."""
EVERY = 64
"""Where they would take more, one in so many ticks has them all."""


class Detail:
    """Switches the time stamps of a graph, between ticks.

    Args:
        graph: compiled with `trace`.
        statistics: of its ticks.

    Attributes:
        at: the number of ticks at which to call it again.
    """

    def __init__(self, graph: CompiledGraph, statistics: TickStatistics) -> None:
        self._graph, self._statistics = graph, statistics
        self.at = LEARN

    def __call__(self) -> None:
        """Decide how the next tick is stamped, and the ones behind it."""
        graph, count = self._graph, self._statistics.count
        if not graph.detailed:
            graph.watch(True)
            self.at = count + 1
        elif count > LEARN or self._dear():
            graph.watch(False)
            self.at = count + EVERY - 1
        else:
            self.at = -1

    def _dear(self) -> bool:
        times = memoryview(np.zeros(LEARN, np.int64).data)
        for i in range(LEARN):
            times[i] = time.perf_counter_ns()
        price = float(np.median(np.diff(times))) * 1e-3 * len(self._graph.blocks)
        return price > SHARE * float(np.median(self._statistics.durations_us()))
