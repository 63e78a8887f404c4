"""Samples of what a benchmark compares, in interleaved rounds: steps in turns, and paced loops."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from unicon_base.arrays import Float64
from unicon_core.runtime import TickStatistics
from unicon_ros.bench.report import Bench

Step = Callable[[], object]
TICK, WHOLE = "recv to send", "whole tick"


def timed(step: Callable[..., object], *arguments: object) -> float:
    """Return the time of a call in [µs]."""
    begin = time.perf_counter_ns()
    step(*arguments)
    return (time.perf_counter_ns() - begin) * 1e-3


class Samples:
    """Samples of each case, by rounds."""

    def __init__(self) -> None:
        self._rounds: defaultdict[str, list[Float64]] = defaultdict(list)

    def add(self, name: str, samples: ArrayLike) -> None:
        """Add one round of a case."""
        self._rounds[name].append(np.atleast_1d(np.asarray(samples, np.float64)))

    def take(self, cases: Mapping[str, Step], samples: int, calls: int) -> None:
        """Time one round of steps that take turns, in [µs]; so many calls make a sample."""
        now, repeats = time.perf_counter_ns, range(calls)
        times = {name: np.zeros(samples) for name in cases}
        for i in range(samples):
            for name, step in cases.items():
                begin = now()
                for _ in repeats:
                    step()
                times[name][i] = (now() - begin) * 1e-3 / calls
        for name, values in times.items():
            self.add(name, values)

    def add_to(self, bench: Bench, *claims: tuple[str, str, str, float]) -> None:
        """Add all cases to a benchmark, and ratios of their medians.

        Args:
            bench: is added to.
            claims: name, case, case of the baseline and bar of each ratio; left out where one of
                the cases was not measured.
        """
        for name in self.names:
            bench.case(name, self.of(name))
        for name, case, base, bar in claims:
            if {case, base} <= self._rounds.keys():
                bench.ratio(name, self.ratio(case, base), bar)

    @property
    def names(self) -> list[str]:
        """The cases, in the order in which they came."""
        return list(self._rounds)

    def of(self, name: str) -> Float64:
        """Return all samples of a case."""
        return np.concatenate(self._rounds[name])

    def ratio(self, one: str, other: str, *, percent: float = 50.0) -> float:
        """Return the median over the rounds of the ratio of two cases' percentiles."""
        return float(np.median(self.ratios(one, other, percent=percent)))

    def ratios(self, one: str, other: str, *, percent: float = 50.0) -> Float64:
        """Return the ratio of two cases' percentiles in each round, shape (rounds,)."""
        above, below = (
            np.array([np.percentile(samples, percent) for samples in self._rounds[name]])
            for name in (one, other)
        )
        found: Float64 = above / below
        return found


@dataclass(frozen=True)
class Paced:
    """What was measured of a loop.

    Attributes:
        late: start minus deadline of each tick in [µs].
        took: time of the work of each tick in [µs].
        share: of a core, in [%].
    """

    late: Float64
    took: Float64
    share: float


def paced(
    ticks: int, rate: float, wait: Callable[[int], object], work: Step = lambda: None
) -> Paced:
    """Run a loop with absolute deadlines.

    Args:
        rate: ticks per second in [Hz].
        wait: returns at a time of `time.perf_counter_ns`.
        work: what a tick does.
    """
    period = round(1e9 / rate)
    late, took = np.zeros((2, ticks))
    now = time.perf_counter_ns
    cpu, begin = time.process_time_ns(), now()
    due = begin + period
    for i in range(ticks):
        wait(due)
        woken = now()
        work()
        took[i] = now() - woken
        late[i] = woken - due
        due += period
    share = (time.process_time_ns() - cpu) / (now() - begin)
    return Paced(late * 1e-3, took * 1e-3, share * 100.0)


def tick_times(statistics: TickStatistics, first: int) -> dict[str, Float64]:
    """Return from recv to the end of send, and all of each tick that a run has kept, in [µs].

    Args:
        statistics: of the run.
        first: ticks at the beginning that are left out.
    """
    rows = statistics.kept()[first:]
    whole = np.asarray((rows[:, 1] - rows[:, 2]) * 1e-3, np.float64)
    return {TICK: statistics.durations_us()[first:], WHOLE: whole}


def unsaid(line: str) -> None:
    """Take what a run would tell."""


def sleep_until(due: int) -> None:
    """Sleep until a time of `time.perf_counter_ns`, as plain loops do."""
    remaining = due - time.perf_counter_ns()
    if remaining > 0:
        time.sleep(remaining * 1e-9)
