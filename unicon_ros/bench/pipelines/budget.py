"""`unicon bench latency --budget`: what the time of a tick on state goes to, who takes it and when.

`measure_budget` runs the fast robot and, as `main`, our controller on state with a recording,
services and a mirrored topic, as users run it. Rows are sorted by when they are: before the tick,
between state and command, after the command, and between two ticks, where only what lasts longer
than the slack delays anybody.

Beside the time stamps of all blocks the controller notes of each tick what happens between two
ticks: warm-ups, garbage collection, page faults and the switches that the kernel forced on the
thread. Its log is one .npz: `columns` and `rows` (ticks, columns), `labels` and `spans` of blocks
in [µs] (ticks, blocks), and `deferred`, which of those run after `send`.
"""

from __future__ import annotations

import gc
import resource
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from unicon_base import AnyDict, AnyMapping, UniconError
from unicon_core.flow import Block, Stage
from unicon_core.pacing import WallClock, WarmUp
from unicon_core.runtime import Runner, RunOptions, ticker
from unicon_core.signals import SIGNALS
from unicon_core.workflow import HookBlocks, Program, load_document
from unicon_ros.attachments import Asked, attached
from unicon_ros.bench.loops import Loop, Slice
from unicon_ros.bench.pipelines.log import MIRROR, Log, arguments
from unicon_ros.bench.pipelines.unicon import joint_states_entry, write_bridged
from unicon_ros.bench.report import Bench, loopback_environment
from unicon_ros.bridge import RosSession

COLUMNS = (
    *("stamp", "begin", "collected", "collections", "warmed", "warm_ups", "cold", "warm"),
    *("faults", "switches"),
)
"""Of a tick: when its state was made and when it began, on the wall clock; what came since the tick
before it: time of garbage collection and how often, of warm-ups and how many, the first and the
last of them, all in [ns]; minor page faults, involuntary switches of the thread."""


class Meter:
    """Blocks at both ends of the graph, which note what a tick costs.

    Args:
        log: gets a row a tick.
    """

    def __init__(self, log: Log) -> None:
        self.log = log
        self._begin_ns = self._collect_begin = 0
        self._collected = self._collections = 0
        self._warm: list[int] = []
        self._before = self._counted()
        gc.callbacks.append(self._collecting)
        # The ticker makes one for each phase; nothing else sees how long it takes.
        setattr(ticker, "WarmUp", self._timed)  # noqa: B010  mypy takes it for private

    def _timed(self, warm_up: Callable[[], object], clock: WallClock, longest_ns: int) -> WarmUp:
        def timed() -> None:
            begin = time.perf_counter_ns()
            warm_up()
            self._warm.append(time.perf_counter_ns() - begin)

        return WarmUp(timed, clock, longest_ns)

    def first(self, program: Program) -> HookBlocks:
        """Return the hook that comes before all others."""

        def begin() -> None:
            self._begin_ns = time.time_ns()

        return {Stage.ESTIMATE: [Block("begin", begin)]}

    def last(self, program: Program) -> HookBlocks:
        """Return the hook that comes after all others."""
        stamp = program.states["stamp_ns"]

        def note() -> None:
            if not stamp[()]:
                return
            warm, counted = self._warm or [0], self._counted()
            self.log.add(
                *(int(stamp), self._begin_ns, self._collected, self._collections),
                *(sum(warm), len(self._warm), warm[0], warm[-1]),
                *(now - was for now, was in zip(counted, self._before)),
            )
            self._warm, self._before = [], self._counted()
            self._collected = self._collections = 0

        return {Stage.OBSERVE: [Block("note", note, reads=("stamp_ns",))]}

    def close(self) -> None:
        """Count no garbage collection any more."""
        gc.callbacks.remove(self._collecting)

    def _collecting(self, phase: str, info: dict[str, int]) -> None:
        if phase == "start":
            self._collect_begin = time.perf_counter_ns()
        else:
            self._collected += time.perf_counter_ns() - self._collect_begin
            self._collections += 1

    def _counted(self) -> tuple[int, int]:
        used = resource.getrusage(resource.RUSAGE_THREAD)
        return used.ru_minflt, used.ru_nivcsw


def main() -> None:
    """Run until SIGTERM."""
    options = arguments()
    log = Log(options.out, *COLUMNS)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path, _ = write_bridged(folder, options.joints, options.rate, False, "state")
        mirror = folder / "mirror.yaml"
        mirror.write_text(f"publish:\n{joint_states_entry(MIRROR, best_effort=False)}\n")
        document = load_document(path)
        meter, session = Meter(log), RosSession(map=mirror, node_name="controller")
        asked = {"record": str(folder / "run.mcap"), "faults": "off"}
        attachments = attached(Asked(asked, document, str(mirror), session, print))
        hooks = [meter.first, session.hook, *(each.hook for each in attachments), meter.last]
        runner = Runner(Program(document, hooks=hooks), RunOptions(detail=True))
        session.attach(runner)
        for each in attachments:
            each.attach(runner)
        runner.run()
        meter.close()
        for each in attachments:
            each.close()
        session.close()
    _save(log, runner)


def _save(log: Log, runner: Runner) -> None:
    statistics = runner.statistics
    labels = list(statistics.labels)
    columns: AnyDict = {
        "columns": np.array(log.columns),
        "rows": log.rows[: log.count],
        "labels": np.array(labels),
        "spans": np.stack([statistics.spans_us(label) for label in labels], axis=1),
        "deferred": np.array([i in statistics.deferred for i in range(len(labels))]),
    }
    np.savez(log.path, **columns)


if __name__ == "__main__":
    main()

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


def add(bench: Bench, log: AnyMapping, measured: Slice) -> None:
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
