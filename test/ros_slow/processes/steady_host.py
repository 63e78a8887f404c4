"""A workflow with its bridge that ticks until SIGTERM or a fault; keeps the times of all ticks.

Usage: steady_host.py WORKFLOW OUT.npz. The times are of `time.perf_counter_ns`, which all processes
of a Linux machine share.
"""

from __future__ import annotations

import sys

import numpy as np

from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import load_workflow
from unicon_ros.bridge import RosSession


def main() -> None:
    session = RosSession(node_name="steady", warn=lambda text: print(text, file=sys.stderr))
    workflow = load_workflow(sys.argv[1], hooks=[session.hook])
    runner = Runner(workflow, RunOptions(capacity=200_000))
    session.attach(runner)
    report = runner.run()
    counts = session.counts()
    session.close()
    statistics = runner.statistics
    rows = statistics.kept()
    ends = [4 + i for i in range(len(statistics.names)) if i not in statistics.deferred]
    np.savez(
        sys.argv[2],
        due=rows[:, 0],
        start=rows[:, 2],
        sent=rows[:, ends].max(axis=1),
        faults=report.faults,
        received=counts["received"],
        served=counts["services"]["served"],
        rows=rows,
        names=list(statistics.names),
    )


main()
