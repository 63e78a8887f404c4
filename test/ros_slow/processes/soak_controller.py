"""Our controller behind platform `ros`, ticking with the states; tells what it sent and keeps.

Arguments are those of the pipelines and `--trace-after S`: from then on Python's own memory is
traced, which costs time; CPU is measured before.
"""

from __future__ import annotations

import gc
import sys
import tempfile
import time
import tracemalloc
from pathlib import Path

import numpy as np

from unicon_core.flow import Block, Stage
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import HookBlocks, Program, load_workflow
from unicon_ros.bench.pipelines.log import arguments
from unicon_ros.bench.pipelines.unicon import write_bridged


def main() -> None:
    at = sys.argv.index("--trace-after")
    trace_after = float(sys.argv[at + 1])
    del sys.argv[at : at + 2]
    options = arguments()
    sent = np.full(1_000_000, -1, np.int64)  # filled, so that its pages do not look like growth
    count = 0
    begin = 0.0
    traced = [0, 0]

    def note_sent(workflow: Program) -> HookBlocks:
        stamp = workflow.states["stamp_ns"]

        def note() -> None:
            nonlocal count, begin
            sent[count] = stamp
            count += 1
            begin = begin or time.monotonic()
            if not tracemalloc.is_tracing() and time.monotonic() - begin > trace_after:
                tracemalloc.start()
                traced[0] = count
            elif traced[0] and count == traced[0] + 100:
                gc.collect()
                traced[1] = tracemalloc.get_traced_memory()[0]

        return {Stage.OBSERVE: [Block("note", note, reads=("stamp_ns",))]}

    with tempfile.TemporaryDirectory() as folder:
        path, topics = write_bridged(Path(folder), options.joints, options.rate, False, "state")
        # The command's queue is deep on both sides: what was sent must arrive.
        before, _, command = topics.read_text().rpartition("depth: 1")
        topics.write_text(f"{before}depth: 50{command}")
        workflow = load_workflow(path, hooks=[note_sent])
        # So few rows are full, and their memory touched, within the first seconds.
        runner = Runner(workflow, RunOptions(capacity=64))
        report = runner.run()
        gc.collect()
        growth = tracemalloc.get_traced_memory()[0] - traced[1] if traced[1] else -1
        np.savez(
            options.out,
            sent=sent[:count],
            traced_growth=growth,
            faults=len(report.faults),
            overruns=report.overruns,
        )


main()
