"""Windows of a run that was disturbed, beside a quiet run of the same workflow at the same time."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

Window = tuple[int, int]


class Windows:
    """Spans of time in [ns] in which one of the two hosts was disturbed."""

    def __init__(self) -> None:
        self.spans: list[Window] = []

    @contextmanager
    def disturb(self) -> Iterator[None]:
        """A disturbed window: the body."""
        begin = time.perf_counter_ns()
        yield
        self.spans.append((begin, time.perf_counter_ns()))


def compare(disturbed: Path, quiet: Path, spans: list[Window]) -> dict[str, float]:
    """Return the p99 of recv → send of one host over that of the other in the same windows.

    Both ran at the same time on the same cores, so that what else the machine does falls on both;
    the median over the windows, since it falls on single ones. The same for how late ticks start.
    """
    facts: dict[str, float] = {"windows": len(spans)}
    hosts = {"disturbed": _times(disturbed), "quiet": _times(quiet)}
    for name in ("tick", "late"):
        p99 = {
            host: np.array([_p99(times["start"], times[name], span) for span in spans])
            for host, times in hosts.items()
        }
        facts |= {f"{name}_{host}_us": float(np.median(each)) for host, each in p99.items()}
        facts[f"{name}_ratio"] = float(np.median(p99["disturbed"] / p99["quiet"]))
    return facts


def _times(file: Path) -> dict[str, np.ndarray]:
    rows = np.load(file)
    start = rows["start"]
    return {
        "start": start,
        "tick": (rows["sent"] - start) * 1e-3,
        "late": (start - rows["due"]) * 1e-3,
    }


def _p99(start: np.ndarray, values: np.ndarray, span: Window) -> float:
    inside = values[(start >= span[0]) & (start < span[1])]
    told = f"{inside.size} ticks in {span}, of {start.size} in {start[0]} to {start[-1]}"
    assert inside.size > 100, told
    return float(np.percentile(inside, 99))
