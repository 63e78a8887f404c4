"""`unicon bench timing`: how late a 500 Hz loop wakes, ours beside a plain `time.sleep` loop.

Both loops have absolute deadlines, so that only the waiting differs. Rounds are interleaved. On a
machine that others keep busy, both wake when the scheduler lets them: a third case has real-time
priority, where that is permitted; it is shown beside and is in no ratio.
"""

from __future__ import annotations

import ctypes
import sys
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from unicon_core.runtime import Pacing, WallClock, prepare_process
from unicon_ros.bench.report import Bench

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
    loops: dict[str, Callable[[int], tuple[NDArray[np.float64], float]]] = {
        "time.sleep": _sleeping,
        "unicon": lambda ticks: _pacing(ticks, Pacing()),
    }
    if _permitted(REAL_TIME):
        loops["unicon, SCHED_FIFO"] = lambda ticks: _pacing(ticks, REAL_TIME)
    errors: dict[str, list[NDArray[np.float64]]] = {name: [] for name in loops}
    shares: dict[str, list[float]] = {name: [] for name in errors}
    for _ in range(rounds):
        for name, loop in loops.items():
            late, share = loop(round(RATE * SECONDS))
            errors[name].append(late)
            shares[name].append(share)
    for name, parts in errors.items():
        bench.case(f"{name}: deadline error", np.concatenate(parts))
        bench.case(f"{name}: share of a core [%]", np.array(shares[name]) * 100.0)
    p99 = {name: [float(np.percentile(part, 99)) for part in errors[name]] for name in errors}
    ratios = [ours / plain for ours, plain in zip(p99["unicon"], p99["time.sleep"])]
    bench.ratio("deadline_p99", float(np.median(ratios)), 0.05)
    bench.ratio("pacing_cpu", float(np.median(shares["unicon"])), 0.08)
    return bench


def _measured(ticks: int, wait: Callable[[int], object]) -> tuple[NDArray[np.float64], float]:
    """Return start minus deadline of each tick in [µs], and the share of a core."""
    period = round(1e9 / RATE)
    late = np.zeros(ticks)
    now = time.perf_counter_ns
    cpu, begin = time.process_time_ns(), now()
    due = begin + period
    for i in range(ticks):
        wait(due)
        late[i] = now() - due
        due += period
    share = (time.process_time_ns() - cpu) / (now() - begin)
    return late * 1e-3, share


def _sleeping(ticks: int) -> tuple[NDArray[np.float64], float]:
    if sys.platform == "linux":  # 29 is PR_SET_TIMERSLACK; 0 restores the process's own, 50 µs
        ctypes.CDLL(None).prctl(29, ctypes.c_ulong(0), 0, 0, 0)

    def wait(due: int) -> None:
        remaining = due - time.perf_counter_ns()
        if remaining > 0:
            time.sleep(remaining * 1e-9)

    return _measured(ticks, wait)


def _permitted(pacing: Pacing) -> bool:
    refused: list[str] = []
    prepare_process(pacing, refused.append)()
    return not refused


def _pacing(ticks: int, pacing: Pacing) -> tuple[NDArray[np.float64], float]:
    restore = prepare_process(pacing, print)
    try:
        return _measured(ticks, WallClock(round(pacing.spin_us * 1e3)).until)
    finally:
        restore()
