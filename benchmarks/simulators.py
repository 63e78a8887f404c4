"""`unicon bench simulators`: a tick of each simulator beside its physics, servo and reads alone.

A Go2 holds its default pose at 50 Hz in every simulator that is installed. `engine` is what any
program has to do: the servo and a physics step as often as a tick has them, joints read after each,
the base read at the end and one step before it. `beyond` is the rest of `send` and `recv` in the
same tick, `tick` their sum.
"""

from __future__ import annotations

import time

import numpy as np

from benchmarks.samples import Samples
from unicon_base.arrays import Float64
from unicon_base.errors import MissingDependencyError
from unicon_core.platforms.kit.stepped import SteppedSimulator
from unicon_core.workflow import load_workflow
from unicon_core.workflow.registry import known
from unicon_lab.transfer.plan import OURS
from unicon_ros.bench.report import Bench

TICKS = 40
"""In a round of one simulator."""

BAR = 1.05
"""Of `tick` to `engine` of PyBullet; of the others nothing is promised."""


def run_simulators(rounds: int | None = None) -> Bench:
    """Run the comparison.

    Args:
        rounds: interleaved rounds, 10 unless told.
    """
    bench = Bench("simulators", rounds or 10)
    times = Samples()
    platforms: dict[str, SteppedSimulator] = {}
    for name in (n for n, at in known("platforms").items() if at.startswith(OURS)):
        try:
            workflow = load_workflow("go2_stand", [f"platform={name}", "flow=hold"])
        except MissingDependencyError as error:
            bench.facts[name] = f"left out: {error}"
            continue
        platform = workflow.platform
        if not isinstance(platform, SteppedSimulator):
            workflow.close()
            continue
        robot, states = workflow.robot, workflow.states
        platform.recv()
        states.joint_pos_target = states.joint_pos
        states.joint_stiffness = robot.joint_stiffness
        states.joint_damping = robot.joint_damping
        platforms[name] = platform
        bench.facts[f"{name}: physics steps in a tick"] = platform.decimation
    for _ in range(bench.rounds):
        for name, one in platforms.items():
            engine, beyond = _ticks(one)
            times.add(f"{name}: engine", engine)
            times.add(f"{name}: beyond", beyond)
            times.add(f"{name}: tick", engine + beyond)
    for one in platforms.values():
        one.close()
    times.add_to(bench, ("pybullet", "pybullet: tick", "pybullet: engine", BAR))
    return bench


def _ticks(platform: SteppedSimulator) -> tuple[Float64, Float64]:
    """Return the time of the engine in each tick, and of the rest of it, in [µs]."""
    now, advance, spent = time.perf_counter_ns, platform.advance, np.zeros((2, TICKS))
    inside = 0

    def timed() -> None:
        nonlocal inside
        begin = now()
        advance()
        inside = now() - begin

    platform.advance = timed  # type: ignore[method-assign]
    try:
        for i in range(TICKS):
            begin = now()
            platform.send()
            platform.recv()
            spent[:, i] = inside, now() - begin - inside
    finally:
        del platform.advance
    return spent[0] * 1e-3, spent[1] * 1e-3
