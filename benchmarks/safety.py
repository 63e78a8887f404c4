"""`unicon bench safety`: what a robot's safety blocks add to its tick, at real rate.

Two graphs of a robot with 29 joints and a policy tick in turns, 10 ms apart, each with warm-ups
before its deadline as a run has them: one with the set of safety blocks that a robot has, one
without any. What is timed is the way from recv to the end of send.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.samples import Samples, random_policy, timed, unsaid
from unicon_core.robots import load_robot
from unicon_core.runtime import Runner, RunOptions, WallClock, WarmUp, prepare_process
from unicon_core.workflow import load_workflow
from unicon_ros.bench.report import Bench

ROBOT = "g1_29dof"
TICKS = 150
"""Of each graph in a round."""
APART_NS = 10_000_000

WITH, WITHOUT = "tick with a robot's safety blocks", "tick without"

_WORKFLOW = f"""\
robot: {ROBOT}
platform: fake_robot
platforms: {{fake_robot: {{time_constant: 0.2}}}}
start: none
policies: {{walk: ./policy}}
commands: [{{velocity_command: {{constant: [0.1, 0.0, 0.0]}}}}]
flow: {{policy: walk}}
"""


def run_safety(rounds: int | None = None) -> Bench:
    """Run the comparison.

    Args:
        rounds: interleaved rounds, 10 unless told.
    """
    bench = Bench("safety", rounds or 10)
    times = Samples()
    with tempfile.TemporaryDirectory() as folder:
        random_policy(Path(folder) / "policy", load_robot(ROBOT))
        path = Path(folder) / "safety.yaml"
        path.write_text(_WORKFLOW, encoding="utf-8")
        programs = {WITH: load_workflow(path), WITHOUT: load_workflow(path, {"safety": "none"})}
        runners = {name: Runner(each, RunOptions(warn=unsaid)) for name, each in programs.items()}
        restore = prepare_process(programs[WITH].pacing, unsaid)
        try:
            for _ in range(bench.rounds):
                for name, samples in _turn(runners).items():
                    times.add(name, samples)
        finally:
            restore()
            for runner in runners.values():
                runner.close()
    times.add_to(bench, ("safety", WITH, WITHOUT, 1.15))
    added = float(np.median(np.subtract(times.of(WITH), times.of(WITHOUT))))  # 10 ms apart
    bench.facts = {
        "blocks": ", ".join(programs[WITH].safety),
        "they add to a tick, median": f"{added:.1f} µs",
    }
    return bench


def _turn(runners: dict[str, Runner]) -> dict[str, Any]:
    """Return the times of one round of ticks in [µs]."""
    now = time.perf_counter_ns
    waits = {
        name: WarmUp(runner.graph.warm_up, WallClock(0), round(runner.pacing.dry_run_us * 1e3))
        for name, runner in runners.items()
    }
    times = {name: np.zeros(TICKS) for name in runners}
    due = now() + APART_NS
    for i in range(TICKS):
        for name, runner in runners.items():
            waits[name].until(due)
            times[name][i] = timed(runner.graph.step)
            runner.graph.deferred()
            due = max(due + APART_NS, now())
    return {name: values[10:] for name, values in times.items()}  # warm-ups learn their lead
