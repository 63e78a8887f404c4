"""Statistics: tick and block times, always on and cheap, for tables, reports and traces.

Reading the clock takes as long as two blocks that do nothing: in a tick of 100 µs with 15 blocks
that is 1 %, and each tick has the detail of all blocks; in one of 5 µs with 60 few ticks have it.
"""

from __future__ import annotations

import json
import os
import re
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base.arrays import Array, Bool, Float64, Int64
from unicon_core.flow import CompiledGraph
from unicon_core.pacing import REAL_TIME, Pacing
from unicon_core.text_table import aligned


def percentiles(values_us: Array) -> dict[str, float]:
    """Return p50, p99 and max of times in [µs], to the clock's ns; zeros where there are none."""
    if not values_us.size:
        return {"p50": 0.0, "p99": 0.0, "max": 0.0}
    values = np.percentile(values_us, [50, 99, 100])
    return {name: round(float(each), 3) for name, each in zip(("p50", "p99", "max"), values)}


def _cells(times_us: dict[str, float], period_us: float) -> list[str]:
    """Return p50, p99, max and the share of the period, without digits that mean nothing."""
    values = [times_us[name] for name in ("p50", "p99", "max")]
    cells = [f"{each:.{0 if each >= 100.0 else 1}f}" for each in values]
    return [*cells, f"{times_us['p50'] / period_us:.1%}"]


class TickStatistics:
    """Time stamps of the most recent ticks, one preallocated row each.

    Attributes:
        labels: the names, made different where two blocks share one.

    Args:
        names: block labels, in the order of the trace columns.
        deferred: numbers of the blocks that run after `send`.
        capacity: how many ticks are kept; older ones are overwritten.
        groups: numbers of the blocks that share a stamp in ticks without detail.
    """

    def __init__(
        self,
        names: Sequence[str],
        deferred: frozenset[int],
        capacity: int = 32_768,
        groups: Sequence[Sequence[int]] = (),
    ) -> None:
        self.names = tuple(names)
        self.labels = tuple(
            name if name not in names[:i] else f"{name}#{i}" for i, name in enumerate(names)
        )
        self.deferred = deferred
        self.rows = np.zeros((capacity, 4 + len(names)), dtype=np.int64)
        self._flat, self._width = memoryview(self.rows.reshape(-1).data), 4 + len(names)
        self._shared = np.zeros(capacity, np.bool_)
        self._groups = {group[-1]: group for group in groups}
        self.count = 0
        self.overruns = 0

    def add(self, due_ns: int, end_ns: int, stamps: memoryview, detailed: bool = True) -> None:
        """Keep one tick.

        Args:
            due_ns: when it was due.
            end_ns: when it ended.
            stamps: as of `CompiledGraph`, int64.
            detailed: each block has its own; else the groups' last ones have.
        """
        flat, width, number = self._flat, self._width, self.count % len(self.rows)
        at = number * width
        flat[at + 2 : at + width] = stamps
        flat[at] = due_ns
        flat[at + 1] = end_ns
        self._shared[number] = not detailed
        self.count += 1

    def take_memory(self) -> None:
        """Touch all rows: what is only reserved would grow while it ticks, a fault of 2 MB at once.

        Takes 3 to 10 ms, which runs that are over at once need not pay.
        """
        self.rows[self.count :] = 0

    def kept(self) -> Int64:
        """Return the rows kept, oldest first: due, end, step start, deferred start, block ends."""
        capacity = len(self.rows)
        if self.count <= capacity:
            return self.rows[: self.count]
        return np.roll(self.rows, -(self.count % capacity), axis=0)

    def _kept_shared(self) -> Bool:
        """Return which of the rows kept have stamps of groups."""
        shared = self._shared[: self.count]
        return shared if self.count <= len(shared) else np.roll(shared, -(self.count % len(shared)))

    def group_label(self, number: int) -> str:
        """Return what stands for the blocks whose stamp is that of a block."""
        group = self._groups.get(number, (number,))
        first, last = (self.labels[i] for i in (group[0], group[-1]))
        return first if first == last else f"{first} … {last}, {len(group)} blocks"

    def _sent_ns(self) -> Int64:
        """Return when the last block ended that is not put off, of each kept tick."""
        ends = [4 + i for i in range(len(self.names)) if i not in self.deferred]
        sent: Int64 = self.kept()[:, ends].max(axis=1, initial=0)
        return sent

    def durations_us(self) -> Float64:
        """Return recv → send of each kept tick in [µs], shape (ticks,)."""
        rows = self.kept()
        if not rows.size or len(self.deferred) == len(self.names):
            return np.empty(0)
        took = self._sent_ns() - rows[:, 2]
        microseconds: Float64 = np.multiply(took, 1e-3, dtype=np.float64)
        return microseconds

    def tick_us(self) -> dict[str, float]:
        """Return p50, p99, max of recv → send in [µs]."""
        return percentiles(self.durations_us())

    def lateness_us(self) -> dict[str, float]:
        """Return p50, p99, max of start minus deadline in [µs]."""
        rows = self.kept()
        return percentiles((rows[:, 2] - rows[:, 0]) * 1e-3)

    def woken_late_us(self) -> Float64:
        """Return start minus deadline of kept ticks that the tick before did not hold up, [µs]."""
        rows = self.kept()
        free = rows[1:, 0] >= rows[:-1, 1]
        late = (rows[1:, 2] - rows[1:, 0])[free]
        return np.asarray(late * 1e-3, np.float64)

    def block_us(self) -> dict[str, dict[str, float]]:
        """Return label to p50, p99, max in [µs] and the number of calls, of ticks with detail."""
        starts, ends = self._spans()
        detailed = ~self._kept_shared()
        table: dict[str, dict[str, float]] = {}
        for i, label in enumerate(self.labels):
            ran = (ends[:, i] > 0) & detailed
            table[label] = {
                **percentiles((ends[ran, i] - starts[ran, i]) * 1e-3),
                "calls": int(ran.sum()),
            }
        return table

    def spans_us(self, label: str) -> Float64:
        """Return how long a block took in each kept tick in [µs]; 0 where it did not run."""
        starts, ends = self._spans()
        column = self.labels.index(label)
        took = np.where(ends[:, column] > 0, ends[:, column] - starts[:, column], 0)
        return np.asarray(took * 1e-3, np.float64)

    def overrun_blocks(self, period_us: float) -> dict[str, int]:
        """Return label to how many of the kept ticks the block made end after the next was due.

        Named is the one that took longest: of those up to `send` where they alone took too long,
        else of those after it, which then overran their slack. The most frequent comes first.

        Args:
            period_us: of the ticks in [µs].
        """
        starts, ends = self._spans()
        rows = self.kept()
        next_due = rows[:, 0] + round(period_us * 1e3)
        took = np.where(ends > 0, ends - starts, 0)
        after = np.zeros(len(self.names), np.bool_)
        after[list(self.deferred)] = True
        counts: dict[str, int] = {}
        shared = self._kept_shared()
        for i in np.flatnonzero(rows[:, 1] > next_due):
            sent = ends[i, ~after].max(initial=0)
            part = after if sent <= next_due[i] and after.any() else ~after
            if part.any():
                slowest = int(np.where(part, took[i], -1).argmax())
                label = self.group_label(slowest) if shared[i] else self.labels[slowest]
                counts[label] = counts.get(label, 0) + 1
        return dict(sorted(counts.items(), key=lambda item: -item[1]))

    def _spans(self) -> tuple[Int64, Int64]:
        """Return start and end of each block, shape (ticks, blocks); end 0 where it did not run.

        Where blocks share a stamp, the last one stands for all of its group.
        """
        rows = self.kept()
        ends = np.where(rows[:, 4:] < rows[:, 2:3], 0, rows[:, 4:])
        starts = np.empty_like(ends)
        for part, begin in ((False, 2), (True, 3)):
            last = rows[:, begin].copy()
            if part:  # without detail nobody says when they begin
                np.maximum(last, self._sent_ns(), out=last)
            for i in range(len(self.names)):
                if (i in self.deferred) is part:
                    starts[:, i] = last
                    np.maximum(last, ends[:, i], out=last)
        return starts, ends

    def table(self, period_us: float) -> str:
        """Return block × p50/p99/max and share of the period, as text."""
        rows = [["block", "p50 µs", "p99 µs", "max µs", "share", ""]]
        for i, (label, row) in enumerate(self.block_us().items()):
            rows.append([label, *_cells(row, period_us), "after send" * (i in self.deferred)])
        rows.append(["tick", *_cells(self.tick_us(), period_us), ""])
        lines = aligned(rows, right=range(1, 5), underlined=False)
        if self.overruns:
            late = {label for i in self.deferred for label in (self.labels[i], self.group_label(i))}
            for label, count in self.overrun_blocks(period_us).items():
                slack = "its slack in" if label in late else "the period in"
                lines.append(f"{label} overran {slack} {count} of {self.count} ticks")
        return "\n".join(lines)

    def write_trace(self, path: str | Path, process: str) -> None:
        """Write the kept ticks as Chrome trace JSON, which Perfetto opens."""
        Path(path).write_text(self.trace(process), encoding="utf-8")

    def trace(self, process: str, last: int = 0) -> str:
        """Return the kept ticks as Chrome trace JSON.

        Source of the format: Chrome's "Trace Event Format", complete events (`ph: X`, times in µs).

        Args:
            process: what is said to have run.
            last: so many ticks at most; 0 for all.
        """
        starts, ends = (each[-last:] for each in self._spans())
        rows, shared = self.kept()[-last:], self._kept_shared()[-last:]
        origin = int(rows[0, 2]) if len(rows) else 0
        events: list[dict[str, Any]] = [
            {"ph": "M", "pid": 1, "tid": 1, "name": "process_name", "args": {"name": process}},
            {"ph": "M", "pid": 1, "tid": 1, "name": "thread_name", "args": {"name": "tick"}},
        ]

        def span(name: str, start: int, end: int, **further: Any) -> dict[str, Any]:
            times = {"ts": (start - origin) * 1e-3, "dur": (end - start) * 1e-3}
            return {"ph": "X", "pid": 1, "tid": 1, "name": name, **times, **further}

        for tick, (due, end, begin) in enumerate(rows[:, :3].tolist()):
            number = self.count - len(rows) + tick
            late = round((begin - due) * 1e-3, 3)
            events.append(span("tick", begin, end, args={"number": number, "late_us": late}))
            for i, name in enumerate(self.names):
                if ends[tick, i]:
                    name = self.group_label(i) if shared[tick] else name
                    events.append(span(name, int(starts[tick, i]), int(ends[tick, i])))
        return json.dumps({"traceEvents": events, "displayTimeUnit": "ns"})


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
    """Return whether this process was started with a real-time priority (`chrt`)."""
    try:
        return os.sched_getscheduler(0) in (os.SCHED_FIFO, os.SCHED_RR)
    except (OSError, AttributeError):
        return True  # there is none to be had


LEARN = 256
"""Ticks with all stamps, of which it learns how long a tick takes."""
SHARE = 0.1
"""The largest part of a tick that its stamps may take."""
EVERY = 64
"""Where they would take more, one in so many ticks has them all."""


class Detail:
    """Switches the time stamps of a graph, between ticks.

    Args:
        graph: compiled with `trace`.
        statistics: of its ticks.

    Attributes:
        at: the number of ticks at which to call it again.
    """

    def __init__(self, graph: CompiledGraph, statistics: TickStatistics) -> None:
        self._graph, self._statistics = graph, statistics
        self.at = LEARN

    def __call__(self) -> None:
        """Decide how the next tick is stamped, and the ones behind it."""
        graph, count = self._graph, self._statistics.count
        if not graph.detailed:
            graph.watch(True)
            self.at = count + 1
        elif count > LEARN or self._dear():
            graph.watch(False)
            self.at = count + EVERY - 1
        else:
            self.at = -1

    def _dear(self) -> bool:
        times = memoryview(np.zeros(LEARN, np.int64).data)
        for i in range(LEARN):
            times[i] = time.perf_counter_ns()
        # Sorted, not by np.median: its first call takes 10 ms, and a tick is due.
        price = float(np.sort(np.diff(times))[LEARN // 2]) * 1e-3 * len(self._graph.blocks)
        durations = np.sort(self._statistics.durations_us())
        return bool(len(durations)) and price > SHARE * float(durations[len(durations) // 2])
