"""`unicon bench latency --budget`: what the time of a tick on state goes to, who takes it and when.

The fast robot and our controller with a recording, services and a mirrored topic, as users run it.
Rows are sorted by when they are: before the tick, between state and command, after the command, and
between two ticks, where only what lasts longer than the slack delays anybody.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base.errors import UniconError
from unicon_core.signals import SIGNALS
from unicon_ros.bench.domains import loopback_environment
from unicon_ros.bench.loops import Loop, Slice
from unicon_ros.bench.report import Bench

SECONDS = 20.0
"""Of the measurement: 1,000 ticks at 50 Hz."""

LONGEST = 600.0
"""So many ticks at 50 Hz are kept, 30,000 of 32,768, in [s]."""


def measure_budget(common: list[str], seconds: float | None = None) -> Bench:
    """Run both processes and return the budget.

    Args:
        common: arguments of both processes.
        seconds: how long they run in [s]; `SECONDS` if None.

    Raises:
        UniconError: they do not start, there is nothing in the log, or the time is none.
    """
    seconds = SECONDS if seconds is None else seconds
    if not 0.0 < seconds <= LONGEST:
        raise UniconError(
            f"--seconds {seconds:g}: with --budget give more than 0 and at most {LONGEST:g}"
        )
    bench = Bench("latency", 1)
    robot, ours = (
        [sys.executable, "-m", f"unicon_ros.bench.pipelines.{name}", *common]
        for name in ("fast_robot", "budget")
    )
    with tempfile.TemporaryDirectory() as folder, SIGNALS.guard():
        loop = Loop("budget", robot, ours, loopback_environment(), Path(folder) / "robot.npz")
        try:
            loop.start()
            loop.run(seconds)
        finally:
            loop.end()
            loop.close()
        if not loop.controller_log.exists():
            raise UniconError("bench latency --budget: the controller left no log; run it again")
        log = dict(np.load(loop.controller_log))
    [measured] = loop.slices
    add(bench, log, measured)
    bench.facts["cpu, controller [% of a core]"] = f"{100.0 * measured.cpu_share:.1f}"
    return bench


_BETWEEN = {
    "warmed": "warm-ups, all",
    "cold": "warm-up, the first, cold",
    "warm": "warm-up, the last",
    "collected": "garbage collection",
}
_COUNTS = {
    "warm_ups": "warm-ups",
    "collections": "garbage collections",
    "faults": "minor page faults",
    "switches": "involuntary switches of the thread",
}


def add(bench: Bench, log: Mapping[str, Any], measured: Slice) -> None:
    """Add what a log of pipeline `budget` tells of the ticks in a slice of time."""
    # Spans are of the last phase, rows of all; a tick without a state has no row.
    count = min(len(log["rows"]), len(log["spans"]))
    rows, spans, deferred = log["rows"][-count:], log["spans"][-count:], log["deferred"]
    stamp, begin = (rows[:, log["columns"].tolist().index(name)] for name in ("stamp", "begin"))
    within = measured.holds(begin) & measured.fresh(stamp)
    rows, spans = rows[within], spans[within]
    column = dict(zip(log["columns"].tolist(), rows.T))
    under_way = (column["begin"] - column["stamp"]) * 1e-3
    bench.case("before: state made, under way, thread awake, received", under_way)
    for when, part in (("to command", ~deferred), ("after it", deferred)):
        for i in np.flatnonzero(part):
            if spans[:, i].any():
                bench.case(f"{when}: {log['labels'][i]}", spans[:, i])
        bench.case(f"{when}: sum", spans[:, part].sum(axis=1))
    for name, what in _BETWEEN.items():
        bench.case(f"between: {what}", column[name] * 1e-3)
    for name, what in _COUNTS.items():
        values = column[name]
        bench.facts[f"{what}, a tick"] = f"mean {values.mean():.3g}, at most {values.max()}"
