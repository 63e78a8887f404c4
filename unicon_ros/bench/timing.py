"""`unicon bench timing`: how late a 500 Hz loop wakes, ours beside a plain `time.sleep` loop.

Both loops have absolute deadlines, so that only the waiting differs. Rounds are interleaved. On a
machine that others keep busy, both wake when the scheduler lets them: a third case has real-time
priority, where that is permitted; it is shown beside and is in no ratio.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable

import numpy as np

from unicon_core.runtime import Pacing, WallClock, prepare_process
from unicon_ros.bench.report import Bench
from unicon_ros.bench.samples import Paced, Samples, paced, sleep_until

__all__ = ["run"]

RATE = 500.0  # Hz
SECONDS = 4.0  # of each loop in each round
REAL_TIME = Pacing(priority=50)


def run(rounds: int | None = None) -> Bench:
    """Run the comparison.

    Args:
        rounds: interleaved rounds, 5 unless told.
    """
    rounds = rounds or 5
    bench = Bench("timing", seed=0, rounds=rounds)
    loops: dict[str, Callable[[int], Paced]] = {
        "time.sleep": _sleeping,
        "unicon": lambda ticks: _pacing(ticks, Pacing()),
    }
    if _permitted(REAL_TIME):
        loops["unicon, SCHED_FIFO"] = lambda ticks: _pacing(ticks, REAL_TIME)
    errors, shares = Samples(), Samples()
    for _ in range(rounds):
        for name, loop in loops.items():
            measured = loop(round(RATE * SECONDS))
            errors.add(name, measured.late)
            shares.add(name, measured.share)
    for name in loops:
        bench.case(f"{name}: deadline error", errors.of(name))
        bench.case(f"{name}: share of a core [%]", shares.of(name))
    bench.ratio("deadline_p99", errors.ratio("unicon", "time.sleep", percent=99), 0.05)
    bench.ratio("pacing_cpu", float(np.median(shares.of("unicon"))) / 100.0, 0.08)
    return bench


def _sleeping(ticks: int) -> Paced:
    if sys.platform == "linux":  # 29 is PR_SET_TIMERSLACK; 0 restores the process's own, 50 µs
        ctypes.CDLL(None).prctl(29, ctypes.c_ulong(0), 0, 0, 0)
    return paced(ticks, RATE, sleep_until)


def _permitted(pacing: Pacing) -> bool:
    refused: list[str] = []
    prepare_process(pacing, refused.append)()
    return not refused


def _pacing(ticks: int, pacing: Pacing) -> Paced:
    restore = prepare_process(pacing, print)
    try:
        return paced(ticks, RATE, WallClock(round(pacing.spin_us * 1e3)).until)
    finally:
        restore()
