"""Arrivals: predicts when the platform's data come, for ticks that are triggered by them.

Who knows when the next message comes can take in what is old, warm up just before, and stay awake
for a moment around its time (`pacing.arrival_spin_us`): `awaited` tells what that gains.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Sequence
from itertools import pairwise

LEAST_LEAD_NS = 150_000

SHORTEST_SLEEP_NS = 50_000
"""Who sleeps for less than that is woken too late."""

MEMORY = 20
"""Arrivals that a correction is about, at most: a sender's clock drifts."""

LOST = 1 / 8
"""Predictions that are off by more than this part of the interval are no better than chance, which
is off by a quarter."""


class Arrivals:
    """A loop that locks to the phase of evenly sent data.

    Args:
        times: at least two arrivals, in [ns]; some may be missing between them.

    Attributes:
        interval_ns: time between two arrivals.
        jitter_ns: mean distance of an arrival from its prediction.
    """

    def __init__(self, times: Sequence[int]) -> None:
        self.measure(times)

    def measure(self, times: Sequence[int]) -> None:
        """Take interval and phase from arrivals that follow each other, in [ns].

        The interval is the median slope of pairs that lie far apart (Theil and Sen): an arrival
        that was late at either end moved a mean by 2 %, and ten intervals on, that is a fifth of
        one: such a prediction never locks.
        """
        gaps = sorted(after - before for before, after in pairwise(times))
        middle = max(gaps[len(gaps) // 2], 1)
        count = len(times)
        far = max(count // 2, 1)
        slopes = [
            (later - earlier) / max(round((later - earlier) / middle), 1)
            for place, earlier in enumerate(times)
            for later in times[place + far :]
        ]
        self.interval_ns = sorted(slopes)[len(slopes) // 2]
        # Of them all, as they would be at the place of the last.
        late = [
            time_ns + round((times[-1] - time_ns) / self.interval_ns) * self.interval_ns
            for time_ns in times
        ]
        self._last = sorted(late)[count // 2]
        self.jitter_ns = self.interval_ns / 16
        self._astray, self._late = 0, False
        # Of the end of a line through so many, and of its slope: least squares.
        self._variance = 4 / count, 6 / count**2, 12 / count**3

    @property
    def lost(self) -> bool:
        """Whether the predictions have come to nothing, so that they are to be measured anew."""
        return self.jitter_ns > LOST * self.interval_ns

    def nearest(self, time_ns: int) -> int:
        """Return when the arrival is expected that is nearest to a time, in [ns]."""
        steps = round((time_ns - self._last) / self.interval_ns)
        return round(self._last + steps * self.interval_ns)

    def note(self, time_ns: int) -> None:
        """Correct phase and interval by an arrival that was seen at a time in [ns].

        A Kalman filter of both, in units of the arrivals' own variance: what was measured over
        few intervals gives way to what is seen over many.
        """
        steps = max(round((time_ns - self._last) / self.interval_ns), 1)
        expected = self._last + steps * self.interval_ns
        error = time_ns - expected
        phase, both, interval = self._variance
        interval = max(interval, 12 / (MEMORY * steps) ** 3)
        phase += steps * (2 * both + steps * interval)
        both += steps * interval
        spread = math.sqrt(phase + 1)  # grows with the time since the last one
        sixteenth = self.interval_ns / 16
        if abs(error) > max(6 * self.jitter_ns, sixteenth) * spread:
            # One such was delayed; three in a row come from a sender with another phase.
            self._astray = (self._astray + 1) % 3
            self._last = time_ns - (error if self._astray else 0.0)
            return
        self._astray = 0
        self.jitter_ns += (min(abs(error) / spread, 4 * sixteenth) - self.jitter_ns) / 16
        # One that is late by much tells no more than one that is late by a little; two in a row do.
        late, before = error > self.jitter_ns * spread, self._late
        self._late = late
        if late and not before:
            error = self.jitter_ns * spread
        gain, gain_of_interval = phase / (phase + 1), both / (phase + 1)
        self._variance = (
            phase - gain * phase,
            both - gain * both,
            interval - gain_of_interval * both,
        )
        self._last = expected + gain * error
        self.interval_ns += gain_of_interval * error

    def lead_ns(self) -> int:
        """Return how long before a prediction to be ready in [ns]: few come earlier than that."""
        return round(min(max(4 * self.jitter_ns, LEAST_LEAD_NS), self.interval_ns / 2))


def awaited(wait: Callable[[float], bool], expected_ns: int, spin_ns: int) -> bool:
    """Wait for data around the time when they are expected, without a pause; then give up.

    Two cores, which robot and controller share, states at 500 Hz over DDS, ticks at 50 Hz: 200 µs
    took 12 and 7 % off the median from end to end (456 and 449 µs, reliable and best effort), 100
    µs nothing. Who is awake while the sender wakes keeps it off the core that is warm.

    Args:
        wait: returns True once data are there, False after a time in [s].
        expected_ns: when the data are expected, on the clock of `time.perf_counter_ns`.
        spin_ns: how long before and after that to stay awake, in [ns].

    Returns:
        True once data are there, False `spin_ns` after they were expected.
    """
    now = time.perf_counter_ns
    early = expected_ns - spin_ns - now()
    if early > SHORTEST_SLEEP_NS and wait(early * 1e-9):
        return True
    while now() < expected_ns + spin_ns:
        if wait(0.0):
            return True
        os.sched_yield()  # to that thread, where it waits for this core
    return False
