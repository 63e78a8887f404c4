"""Arrivals: predicts when the platform's data come, for ticks that are triggered by them.

A thread that sleeps until a message is there is woken late: by the middleware's thread, from an
idle core, with cold caches. Whoever knows when it comes is awake by then, and warm.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from itertools import pairwise

__all__ = ["Arrivals", "Vigil"]


class Arrivals:
    """A loop that locks to the phase of evenly sent data.

    Args:
        times: at least two arrivals, in [ns]; some may be missing between them.

    Attributes:
        interval_ns: time between two arrivals.
        jitter_ns: mean distance of an arrival from its prediction.
    """

    def __init__(self, times: Sequence[int]) -> None:
        gaps = sorted(after - before for before, after in pairwise(times))
        middle = max(gaps[len(gaps) // 2], 1)
        # The ends tell the interval better than any single gap.
        whole = times[-1] - times[0]
        self.interval_ns = whole / max(round(whole / middle), 1)
        self.jitter_ns = self.interval_ns / 16
        self._last = float(times[-1])
        self._astray = 0

    def nearest(self, time_ns: int) -> int:
        """Return when the arrival is expected that is nearest to a time, in [ns]."""
        steps = round((time_ns - self._last) / self.interval_ns)
        return round(self._last + steps * self.interval_ns)

    def note(self, time_ns: int) -> None:
        """Correct phase and interval by an arrival that was seen at a time in [ns]."""
        steps = max(round((time_ns - self._last) / self.interval_ns), 1)
        error = time_ns - (self._last + steps * self.interval_ns)
        if abs(error) > max(6 * self.jitter_ns, self.interval_ns / 16):
            # One such was delayed; three in a row come from a sender with another phase.
            self._astray = (self._astray + 1) % 3
            self._last = time_ns - (error if self._astray else 0.0)
            return
        self._astray = 0
        self.jitter_ns += (abs(error) - self.jitter_ns) / 16
        self._last = time_ns - error * 7 / 8
        self.interval_ns += error / steps / 64

    def window_ns(self, least: int) -> int:
        """Return how far from its prediction most arrivals lie, in [ns].

        Args:
            least: in [ns]; four times as much is the most, and a quarter of the interval.
        """
        return round(min(max(2.5 * self.jitter_ns, least), 4 * least, self.interval_ns / 4))


class Vigil:
    """Asks for data without a pause while they are expected, where that does not cost a core.

    It gives its core away between two questions: the middleware's thread that brings the data may
    wait for it. If another program takes the core and keeps it, sleeping is better: who is woken
    comes first again. Then it rests for a second.

    Args:
        arrived: returns whether data are there, at once.
    """

    def __init__(self, arrived: Callable[[], bool]) -> None:
        self._arrived = arrived
        self._rests_until = 0

    def until(self, end_ns: int) -> bool:
        """Return True when data are there, False when the time in [ns] is over."""
        now, arrived = time.perf_counter_ns, self._arrived
        before = now()
        if before < self._rests_until:
            return arrived()
        while not arrived():
            _let_others()
            present = now()
            if present > end_ns:
                return False
            if present - before > STOLEN_NS:
                self._rests_until = present + REST_NS
                return arrived()
            before = present
        return True


STOLEN_NS = 500_000
"""A question takes 2 to 50 µs; whoever has the core for longer has work of its own."""

REST_NS = 1_000_000_000


def _sleep() -> None:
    time.sleep(0)


_let_others = getattr(os, "sched_yield", _sleep)
