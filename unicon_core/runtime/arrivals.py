"""Arrivals: predicts when the platform's data come, for ticks that are triggered by them.

Who knows when the next message comes can take in what is old and warm up just before. The wait
itself stays asleep: asking for the message without a pause (with `sched_yield` in between) kept the
middleware's thread, which brings it, from its core. On two cores it came 25 to 45 µs later.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

__all__ = ["Arrivals"]

LEAST_LEAD_NS = 150_000


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

    def lead_ns(self) -> int:
        """Return how long before a prediction to be ready in [ns]: few come earlier than that."""
        return round(min(max(4 * self.jitter_ns, LEAST_LEAD_NS), self.interval_ns / 2))
