"""`unicon bench timing`: how late a 500 Hz loop wakes, ours beside a plain `time.sleep` loop.

Both loops have absolute deadlines, so that only the waiting differs. Rounds are interleaved, the
loops of a round in an order that changes. A ratio of p99 is the median over the rounds of what one
round gives, told with its 95 % interval: single rounds of one run gave 0.02 to 5.6 on two shared
cores, as others took the machine or did not, which is what a p99 is made of. Where others keep the
machine busy, both loops wake when the scheduler lets them: a third case has real-time priority,
where that is permitted; it is shown beside and is in no ratio.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable

import numpy as np

from benchmarks.samples import Paced, Samples, paced, sleep_until
from unicon_core.runtime import Pacing, WallClock, prepare_process
from unicon_ros.bench.loops import interval
from unicon_ros.bench.report import Bench

TIMING_RATE = 500.0  # Hz
ROUNDS = 15
TIMING_SECONDS = 1.5  # of each loop in each round: 750 ticks, whose p99 is the eighth latest
REAL_TIME = Pacing(priority=50)


def run_timing(rounds: int | None = None) -> Bench:
    """Run the comparison.

    Args:
        rounds: interleaved rounds, 15 unless told.
    """
    bench = Bench("timing", rounds or ROUNDS)
    loops: dict[str, Callable[[int], Paced]] = {
        "time.sleep": _sleeping,
        "unicon": lambda ticks: _pacing(ticks, Pacing()),
    }
    if _permitted(REAL_TIME):
        loops["unicon, SCHED_FIFO"] = lambda ticks: _pacing(ticks, REAL_TIME)
    errors, shares = Samples(), Samples()
    for number in range(bench.rounds):
        for name in list(loops)[:: -1 if number % 2 else 1]:
            measured = loops[name](round(TIMING_RATE * TIMING_SECONDS))
            errors.add(name, measured.late)
            shares.add(name, measured.share)
    for name in loops:
        bench.case(f"{name}: deadline error", errors.of(name))
        bench.case(f"{name}: share of a core [%]", shares.of(name))
    late = errors.ratios("unicon", "time.sleep", percent=99)
    bench.ratio("deadline_p99", float(np.median(late)), 0.05)
    bench.facts["deadline_p99, 95 % interval"] = interval(late)
    bench.facts["deadline_p99, of single rounds"] = f"{late.min():.3g} to {late.max():.3g}"
    bench.ratio("pacing_cpu", float(np.median(shares.of("unicon"))) / 100.0, 0.08)
    return bench


def _sleeping(ticks: int) -> Paced:
    if sys.platform == "linux":  # 29 is PR_SET_TIMERSLACK; 0 restores the process's own, 50 µs
        ctypes.CDLL(None).prctl(29, ctypes.c_ulong(0), 0, 0, 0)
    return paced(ticks, TIMING_RATE, sleep_until)


def _permitted(pacing: Pacing) -> bool:
    refused: list[str] = []
    prepare_process(pacing, refused.append)()
    return not refused


def _pacing(ticks: int, pacing: Pacing) -> Paced:
    restore = prepare_process(pacing, print)
    try:
        return paced(ticks, TIMING_RATE, WallClock(round(pacing.spin_us * 1e3)).until)
    finally:
        restore()
