"""What would help a run whose ticks began late, told once at its end."""

from __future__ import annotations

import os

import numpy as np

from unicon_core.runtime.pacing import REAL_TIME, Pacing
from unicon_core.runtime.statistics import TickStatistics

__all__ = ["FEWEST", "LATE", "advice_of"]

LATE = 0.1
"""Share of the period by which one tick in a hundred may begin late before anything is advised:
2 ms at 50 Hz, 0.2 ms at 500 Hz, where an idle machine has 0.03 ms."""

FEWEST = 100
"""Ticks, below which one in a hundred is only the worst."""


def advice_of(statistics: TickStatistics, pacing: Pacing, speed: str, period_ns: int) -> str:
    """Return one line of advice; "" where nothing is late, or the priority is not the reason.

    A tick that began late because the one before it took too long is that block's fault, which
    the report tells by its name.

    Args:
        statistics: of the run.
        pacing: of the run.
        speed: `real`, or `max`, where nothing is late.
        period_ns: of its ticks in [ns].
    """
    if (
        speed != "real"
        or pacing.trigger != "deadline"
        or pacing.priority is not None
        or _real_time()
    ):
        return ""
    late_us = statistics.woken_late_us()
    if len(late_us) < FEWEST:
        return ""
    period_us, p99 = period_ns * 1e-3, float(np.percentile(late_us, 99))
    if p99 <= LATE * period_us:
        return ""
    pinned = "" if pacing.cpu is None else ", and leave out pacing.cpu, which waits for a busy core"
    return (
        f"one tick in 100 began {p99 * 1e-3:.2g} ms late or later, {p99 / period_us:.0%} of the "
        f"period: others had the core; set pacing.priority=80, allowed by {REAL_TIME}{pinned}"
    )


def _real_time() -> bool:
    """Return whether whoever started this process gave it a real-time priority (`chrt`)."""
    try:
        return os.sched_getscheduler(0) in (os.SCHED_FIFO, os.SCHED_RR)
    except (OSError, AttributeError):
        return True  # there is none to be had
