"""`unicon bench sweep`: a rollout of a sweep beside physics and network alone, on the same cores.

A Go2 walks for 10 s with our policy, under pushes, with motors and payloads that differ in every
row. All sides have one process for each core (two at most), and take turns; a rollout of the sweep
has everything in it: scene and program begun anew, safety, figures, the row written down. Engine
`batch` runs the rows that engine `local` has just run, which have to be the same.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.samples import Samples
from unicon_core.models.loaded import import_mujoco
from unicon_core.policies.networks.onnx import OnnxNetwork
from unicon_core.robots import joint_index
from unicon_core.signals import SIGNALS
from unicon_core.workflow import load_workflow
from unicon_lab.sweep.pool import ONE_THREAD, Line, PipedProcess
from unicon_ros.bench.loops import cpu_ns
from unicon_ros.bench.report import Bench

ROLLOUTS = 2000
"""In all rounds together, of each side."""
SECONDS = 10.0
RATE = 50.0
MOST_CORES = 2
SIDES = {"local": "sweep", "batch": "batch"}
"""Engine to the name of its case."""

WORKFLOW = Path(__file__).with_name("walk.yaml")


def run(rounds: int = 20, rollouts: int = ROLLOUTS) -> Bench:
    """Run the comparison.

    Args:
        rounds: interleaved rounds.
        rollouts: of each side in all rounds together.
    """
    from unicon_lab.sweep.engines import LocalEngine, Wish, engine_of
    from unicon_lab.sweep.folder import Folder, require_pyarrow
    from unicon_lab.sweep.plan import Plan
    from unicon_lab.sweep.results import Results
    from unicon_lab.sweep.sweep_file import read_sweep

    require_pyarrow()
    bench = Bench("sweep", rounds)
    cores = min(len(os.sched_getaffinity(0)), MOST_CORES)
    each = max(rollouts // bench.rounds // cores, 1) * cores
    times = Samples()
    with tempfile.TemporaryDirectory() as name, SIGNALS.guard():
        folder = Path(name)
        plan = Plan(read_sweep(WORKFLOW.with_name("sweep.yaml")))
        sides: list[tuple[str, Folder, LocalEngine]] = []
        for engine in SIDES:
            out = Folder(folder / engine, plan, "")
            made = engine_of(plan, Wish(engine, cores), len(plan), out.path)
            assert isinstance(made, LocalEngine)
            sides.append((SIDES[engine], out, made))
        floor: list[PipedProcess] = []
        rows = iter(plan)
        try:
            for i in range(cores):
                process = PipedProcess("benchmarks.sweep", folder / f"bare_{i}.log", ONE_THREAD)
                floor.append(process)
                process.write({"ticks": round(SECONDS * RATE)})
            for number in range(bench.rounds + 1):
                SIGNALS.check()
                todo = [next(rows) for _ in range(each)]
                spent: dict[str, tuple[float, float]] = {}
                for side, out, made in sides:
                    begin, before = time.perf_counter(), _cpu(made.pids)
                    for result in made.run(todo):
                        out.know(result.facts)
                        out.add(result.index, result.figures)
                    SIGNALS.check()
                    spent[side] = time.perf_counter() - begin, _cpu(made.pids) - before
                begin = time.perf_counter()
                for process in floor:
                    process.write({"rollouts": each // cores})
                cpu = sum(process.read()["cpu"] for process in floor)
                spent["bare"] = time.perf_counter() - begin, cpu
                if number:  # the first one builds and warms up
                    per = 1e6 / each
                    for side, (wall, cpu) in spent.items():
                        times.add(side, wall * cores * per)
                        times.add(f"{side}, CPU", cpu * per)
            for _, out, _ in sides:
                out.flush()
            results, others = (Results(out.path) for _, out, _ in sides)
        finally:
            for process in floor:
                process.end()
            for _, out, made in sides:
                made.close()
                out.close()
        bench.facts = {
            "rollouts of each side": each * bench.rounds,
            "processes": cores,
            "no result": results.failed,
            "the same rows": results.sha256 == others.sha256,
        }
    times.add_to(bench)
    return bench


def _cpu(pids: list[int]) -> float:
    """Return seconds of CPU that some processes and this one have spent so far."""
    return 1e-9 * sum(map(cpu_ns, pids)) + time.process_time()


def rollout_of(ticks: int) -> Callable[[], float]:
    """Return a function that runs one rollout of a policy that walks and returns its way in [m].

    Model, actuators and gains are those of the workflow's platform, so that the physics are the
    same; a tick is what no program can do without: the observation written, the network run on it,
    its action into controls, the physics stepped.

    The Go2 walks from its default pose on.

    Args:
        ticks: of a rollout.
    """
    mujoco = import_mujoco()
    program = load_workflow(WORKFLOW)
    platform: Any = program.platform
    (contract,) = program.policies.values()
    model, data, steps = platform.model, platform.data, platform.decimation
    names = program.robot.joint_names
    command = np.array([0.5, 0.0, 0.0], np.float32)
    gains = np.zeros((5, len(names)))
    policy_from_robot = joint_index(contract.joints, names)
    gains[3][policy_from_robot], gains[4][policy_from_robot] = contract.stiffness, contract.damping
    servo = platform.robots[0].servo
    servo.push(data.ctrl, gains)
    joints = np.array(platform._loaded.joints)[policy_from_robot]
    at_pos, at_vel = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    actuators = np.array(servo.actuators)[policy_from_robot]
    first = data.qpos.copy()
    default, scale = contract.default_joint_pos, np.float32(0.25)
    observation, action = np.zeros((1, 45), np.float32), np.zeros((1, 12), np.float32)
    network = OnnxNetwork(contract.model)
    memory = {x.name: np.zeros((1, int(x.shape[1])), np.float32) for x in network.inputs[1:]}
    following = {pair.output: memory[pair.input].copy() for pair in contract.recurrent}
    pairs = [(memory[pair.input], following[pair.output]) for pair in contract.recurrent]
    run = network.bind({"obs": observation, **memory}, {"actions": action, **following})
    row, rotation = observation[0], data.xmat[1].reshape(3, 3)

    def rollout() -> float:
        mujoco.mj_resetData(model, data)
        data.qpos[:] = first
        mujoco.mj_forward(model, data)
        action[...] = 0.0
        for held, _ in pairs:
            held[...] = 0.0
        qpos, qvel, ctrl = data.qpos, data.qvel, data.ctrl
        for _ in range(ticks):
            row[0:3] = qvel[3:6] * 0.25
            row[3:6] = -rotation[2]
            row[6:9] = command * 2.0
            row[9:21] = qpos[at_pos] - default
            row[21:33] = qvel[at_vel] * 0.05
            row[33:45] = action[0]
            run()
            for held, told in pairs:
                held[...] = told
            np.clip(action, -8.0, 8.0, out=action)
            ctrl[actuators] = default + scale * action[0]
            mujoco.mj_step(model, data, steps)
        return float(qpos[0] - first[0])

    return rollout


def main() -> int:
    """Run rollouts as asked for until nobody asks any more."""
    line = Line()
    rollout = rollout_of(line.read()["ticks"])
    while asked := line.read():
        begin = time.process_time()
        for _ in range(asked["rollouts"]):
            rollout()
        line.write({"cpu": time.process_time() - begin})
    return 0


if __name__ == "__main__":
    sys.exit(main())
