"""`unicon bench batch`: cost of a tick per robot, many robots in one graph beside one robot.

Physics is left out (the `fake` platform): what is measured is the tick.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from unicon_core.robots import load_robot
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import load_workflow
from unicon_ros.bench.networks import random_policy
from unicon_ros.bench.report import Bench
from unicon_ros.bench.samples import Samples

__all__ = ["run"]

SIZES = (1, 4, 16, 64, 256)
TICKS = 200

_WORKFLOW = """\
robot: go2
platform: fake
num_robots: 1
policies: {walk: POLICY}
commands:
  - velocity_command: {constant: [0.5, 0.0, 0.0]}
flow: {policy: walk}
safety: [finite, joint_limits]
"""


def run(rounds: int | None = None) -> Bench:
    """Run the comparison.

    Args:
        rounds: interleaved rounds, 5 unless told.
    """
    rounds = rounds or 5
    bench = Bench("batch", seed=0, rounds=rounds)
    times = Samples()
    with tempfile.TemporaryDirectory() as folder:
        random_policy(Path(folder) / "policy", load_robot("go2"))
        path = Path(folder) / "batch.yaml"
        path.write_text(_WORKFLOW.replace("POLICY", "./policy"), encoding="utf-8")
        runners = {}
        for size in SIZES:
            program = load_workflow(path, {"num_robots": size})
            runners[size] = Runner(program, RunOptions(speed="max"))
        for _ in range(rounds):
            for size, runner in runners.items():
                times.add(f"per robot, N = {size}", _ticks(runner) / size)
        for runner in runners.values():
            runner.close()
    for size in SIZES:
        bench.case(f"per robot, N = {size}", times.of(f"per robot, N = {size}"))
    bench.ratio("batch64", times.ratio("per robot, N = 64", "per robot, N = 1"), 0.35)
    return bench


def _ticks(runner: Runner) -> NDArray[np.float64]:
    """Return the time of each tick in [µs]."""
    now = time.perf_counter_ns
    times = np.zeros(TICKS)
    for i in range(TICKS):
        begin = now()
        runner.tick(begin)
        times[i] = (now() - begin) * 1e-3
    return times
