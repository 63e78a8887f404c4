"""Programs: many robots in one, each simulator, and the start of a process.

`unicon bench batch`: cost of a tick per robot, many robots in one graph beside one robot.

Without physics (the `fake` platform) it is the tick that is measured; with them, in MuJoCo, several
robots are simulated at once, as many as there are cores. Where MJX is installed, it steps all of
them in one compiled call.

`unicon bench simulators`: a tick of each simulator beside its physics, servo and reads alone.

A Go2 holds its default pose at 50 Hz in every simulator that is installed. `engine` is what any
program has to do: the servo and a physics step as often as a tick has them, joints read after each,
the base read at the end and one step before it. `beyond` is the rest of `send` and `recv` in the
same tick, `tick` their sum.

`unicon bench start`: from the start of a process to the first tick, beside what it must import.

Each run is a process of its own: one that only imports MuJoCo and ONNX Runtime, and `unicon run
go2_walk`, without and with ROS, the built-in check included. All have their bytecode written
before, as what is installed has, wherever this one may write.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from benchmarks.samples import Samples, random_policy, timed
from unicon_base import AnyDict, MissingDependencyError
from unicon_base.arrays import Float64
from unicon_core.platforms.kit.stepped import SteppedSimulator
from unicon_core.platforms.mujoco.batch import shares
from unicon_core.robots import load_robot
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import load_workflow
from unicon_lab.transfer.rollout import simulators
from unicon_ros import compat
from unicon_ros.bench.report import Bench, loopback_environment

MANY = 64
"""Robots that are compared with one."""

WORKFLOW = Path(__file__).with_name("batch.yaml")
# In place of the same there; our own policy walks, where a random one would fall.
_PHYSICS: AnyDict = {
    "platform": "mujoco",
    "scene": {"initial_pose": "policy:walk"},
    "policies": {"walk": "go2_velocity"},
}


def run_batch(rounds: int = 5) -> Bench:
    """Run the comparison.

    Args:
        rounds: interleaved rounds.
    """
    bench = Bench("batch", rounds)
    kinds = [
        ("per robot", 200, {}),
        ("with physics, per robot", 100, _PHYSICS),
    ]
    if find_spec("mujoco.mjx") and find_spec("jax"):
        compiled = _PHYSICS | {"platform": "mjx"}
        kinds.append(("in MJX, per robot", 20, compiled))
    else:
        bench.facts["MJX"] = "left out: pip install 'unicon_ros[sim-mjx]'"
    times = Samples()
    with tempfile.TemporaryDirectory() as folder:
        random_policy(Path(folder), load_robot("go2"))
        random = {"policies": {"walk": folder}}
        runners: dict[str, tuple[Runner, int, int]] = {}
        for kind, ticks, changed in kinds:
            for size in (1, MANY):
                program = load_workflow(WORKFLOW, random | changed | {"num_robots": size})
                runner = Runner(program, RunOptions(speed="max"))
                runners[f"{kind}, N = {size}"] = runner, size, ticks
        for _ in range(bench.rounds):
            for name, (runner, size, ticks) in runners.items():
                took = [timed(runner.tick, time.perf_counter_ns()) for _ in range(ticks)]
                times.add(name, np.array(took) / size)
        for runner, _, _ in runners.values():
            runner.close()
    times.add_to(bench)
    bench.facts["threads"] = len(shares(MANY))
    return bench


TICKS = 40
"""In a round of one simulator."""


def run_simulators(rounds: int = 10) -> Bench:
    """Run the comparison.

    Args:
        rounds: interleaved rounds.
    """
    bench = Bench("simulators", rounds)
    times = Samples()
    platforms: dict[str, SteppedSimulator] = {}
    for name in simulators():
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
    times.add_to(bench)
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


PATIENCE = 60.0  # s for a process

BASE = "import mujoco, onnxruntime"
RUN, ROS = "unicon run go2_walk", "unicon run go2_walk --ros"

_AGE = """
import time
done = time.monotonic()
from unicon_core.pacing import process_age_s
print(process_age_s() - (time.monotonic() - done))
"""


def run_start(rounds: int = 10) -> Bench:
    """Run the comparison.

    Args:
        rounds: interleaved rounds.

    Raises:
        MissingDependencyError: MuJoCo or ONNX Runtime is not installed.
        RuntimeError: a run fails.
    """
    bench, times = Bench("start", rounds), Samples()
    cases = [BASE, RUN]
    with suppress(MissingDependencyError):
        compat.import_rclpy("unicon bench start")
        cases.append(ROS)
    with tempfile.TemporaryDirectory() as folder:
        environment = _environment(Path(folder))
        for number in range(-1, bench.rounds):  # the first one writes bytecode and warms files up
            for case in cases:
                seconds = _seconds(case, Path(folder), environment)
                if number >= 0:
                    times.add(f"{case} [ms]", seconds * 1e3)
    times.add_to(bench)
    bench.facts["measured"] = "age of the process at the first tick, or at its end, to 10 ms"
    return bench


def _environment(folder: Path) -> dict[str, str]:
    values = loopback_environment() | {"PYTHONPYCACHEPREFIX": str(folder / "bytecode")}
    for name in ("PYTHONDONTWRITEBYTECODE", "MUJOCO_GL"):
        values.pop(name, None)
    return values


def _seconds(case: str, folder: Path, environment: Mapping[str, str]) -> float:
    """Return how old the process was when it was ready, in [s].

    Raises:
        RuntimeError: it failed.
    """
    report = folder / "report.json"
    if case == BASE:
        command = ["-c", BASE + _AGE]
    else:
        command = ["-m", "unicon_ros", *case.split()[1:], "--speed", "max", "--duration", "0.02"]
        command += ["--quiet", "--faults", "off", "--report", str(report)]
    done = subprocess.run(
        [sys.executable, *command],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=PATIENCE,
    )
    if done.returncode:
        line = (done.stderr.strip().splitlines() or ["it told nothing"])[-1]
        raise RuntimeError(f"bench start: {case!r} ended with {done.returncode}: {line}")
    if case == BASE:
        return float(done.stdout.splitlines()[-1])
    return float(json.loads(report.read_text("utf-8"))["startup_s"])
