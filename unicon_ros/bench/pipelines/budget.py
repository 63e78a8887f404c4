"""Process of our controller on state, with services and a recording, that notes where time goes.

Beside the time stamps of all blocks it notes of each tick what happens between two ticks: warm-ups,
garbage collection, page faults and the switches that the kernel forced on the thread. The
log is one .npz: `columns` and `rows` (ticks, columns), `labels` and `spans` of blocks in [µs]
(ticks, blocks), and `deferred`, which of those run after `send`.
"""

from __future__ import annotations

import gc
import resource
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from unicon_core.flow import Block, Stage
from unicon_core.pacing import WallClock, WarmUp
from unicon_core.runtime import Runner, RunOptions, ticker
from unicon_core.workflow import Program
from unicon_core.workflow.document import load_document
from unicon_ros.attachments import Asked, attached
from unicon_ros.bench.pipelines.log import MIRROR, Log, arguments
from unicon_ros.bench.pipelines.unicon import joint_states_entry, write_bridged
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

    def first(self, program: Program) -> dict[Stage, list[Block]]:
        """Return the hook that comes before all others."""

        def begin() -> None:
            self._begin_ns = time.time_ns()

        return {Stage.ESTIMATE: [Block("begin", begin)]}

    def last(self, program: Program) -> dict[Stage, list[Block]]:
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
    columns: dict[str, Any] = {
        "columns": np.array(log.columns),
        "rows": log.rows[: log.count],
        "labels": np.array(labels),
        "spans": np.stack([statistics.spans_us(label) for label in labels], axis=1),
        "deferred": np.array([i in statistics.deferred for i in range(len(labels))]),
    }
    np.savez(log.path, **columns)


if __name__ == "__main__":
    main()
