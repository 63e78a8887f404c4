"""What would help a run whose ticks began late, told once at its end."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np

from unicon_core.pacing import REAL_TIME, Pacing
from unicon_core.runtime.statistics import TickStatistics

LATE = 0.1
"""Share of the period by which one tick in a hundred may begin late before anything is advised:
2 ms at 50 Hz, 0.2 ms at 500 Hz, where an idle machine has 0.03 ms."""

FEWEST = 100
"""Ticks, below which one in a hundred is only the worst."""


WAITING = 30.0
"""Per cent of the last 10 s in which a program waited for a core; an idle machine has 0 to 10."""
STOLEN = 5.0
"""Per cent of a machine's time that its host gave to others."""


class Starvation:
    """Says whether this machine had too little time, of the kernel's figures since it was built.

    Linux tells in /proc/pressure/cpu for how much of the last 10 s programs waited in run queues
    (Documentation/accounting/psi.rst), and in /proc/stat what was stolen (proc_stat(5)).
    """

    PRESSURE, STAT = Path("/proc/pressure/cpu"), Path("/proc/stat")

    def __init__(self) -> None:
        self._before = self._times()

    def __call__(self) -> str:
        """Return what to add to the reason of a silence; "" where the machine had time."""
        found = re.search(r"some avg10=([\d.]+)", _text(self.PRESSURE))
        waited = float(found[1]) if found else 0.0
        spent = [now - was for now, was in zip(self._times(), self._before)]
        stolen = 100.0 * spent[7] / max(sum(spent), 1) if len(spent) > 7 else 0.0
        if waited < WAITING and stolen < STOLEN:
            return ""
        return (
            f"; this machine was starved: programs waited for a core in {waited:.0f} % of the last "
            f"10 s, and {stolen:.0f} % of its time was stolen by its host; end other programs, "
            f"give it more cores, or set pacing.priority=80, allowed by {REAL_TIME}"
        )

    def _times(self) -> list[int]:
        first = _text(self.STAT).partition("\n")[0].split()
        return [int(each) for each in first[1:9] if each.isdecimal()]


def _text(path: Path) -> str:
    try:
        return path.read_text("ascii", "replace")
    except OSError:  # an older kernel, or another system
        return ""


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
