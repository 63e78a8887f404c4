"""Loops at real rate: how late they wake, and what a policy costs in them.

`unicon bench timing`: how late a 500 Hz loop wakes, ours beside a plain `time.sleep` loop.

Both loops have absolute deadlines, so that only the waiting differs. Rounds are interleaved, the
loops of a round in an order that changes. A ratio of p99 is the median over the rounds of what one
round gives, told with its 95 % interval: single rounds of one run gave 0.02 to 5.6 on two shared
cores, as others took the machine or did not, which is what a p99 is made of.

`unicon bench policy`: the policy tick in a real 50 Hz loop, ours beside the usual way.

The usual way is that of most deployment scripts: scaled terms, `np.concatenate`, `np.clip`,
`session.run`, `time.sleep`. Network 45 → 512 → 256 → 128 → 12, one thread on both sides. Rounds are
interleaved. The tick of `unicon run --native` stands beside the network alone in the same loop. The
tick of a policy by chunks, 100 Hz, stands beside the same one whose answers come from no process.
"""

from __future__ import annotations

import os
import tempfile
from collections import deque
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.samples import CLIP, Paced, Samples, Step, paced, random_policy, sleep_until
from unicon_base.arrays import Float32
from unicon_core.flow import as_block
from unicon_core.models.find import pick_model
from unicon_core.models.load import load_model
from unicon_core.models.terrain import RayHeights, SceneGround, load_on
from unicon_core.native.tick import NativeTick
from unicon_core.policies import Observation, Policy, PolicyContract, policy_states
from unicon_core.policies.child_policy import ChildPolicy
from unicon_core.policies.chunks import ChildSpec, ChunkSpec
from unicon_core.policies.networks.child import ChildNetwork, Question, layouts_of, sides_of
from unicon_core.policies.networks.onnx_file import Arrays
from unicon_core.policies.perception import HEIGHT_SCAN, HeightScan, HeightScanSpec
from unicon_core.robots import Robot, load_robot
from unicon_core.runtime import Pacing, WallClock, WarmUp, prepare_process
from unicon_core.states import States, standard_states
from unicon_core.terrain.words import read_terrain
from unicon_ros.bench.report import Bench
from unicon_ros.bench.rounds import interval

TIMING_RATE = 500.0  # Hz
TIMING_SECONDS = 1.5  # of each loop in each round: 750 ticks, whose p99 is the eighth latest


def run_timing(rounds: int = 15) -> Bench:
    """Run the comparison.

    Args:
        rounds: interleaved rounds.
    """
    bench = Bench("timing", rounds)
    loops: dict[str, Callable[[int], Paced]] = {
        "time.sleep": lambda ticks: paced(ticks, TIMING_RATE, sleep_until),
        "unicon": lambda ticks: _ours(ticks, TIMING_RATE),
    }
    late, share = "deadline error", "share of a core [%]"
    times = Samples()
    for number in range(bench.rounds):
        for name in list(loops)[:: -1 if number % 2 else 1]:
            measured = loops[name](round(TIMING_RATE * TIMING_SECONDS))
            times.add(f"{name}: {late}", measured.late)
            times.add(f"{name}: {share}", measured.share)
    times.add_to(bench)
    ratios = times.ratios(f"unicon: {late}", f"time.sleep: {late}", 99)
    bench.facts["deadline_p99, 95 % interval"] = interval(ratios)
    bench.ratio("pacing_cpu", float(np.median(times.of(f"unicon: {share}"))) / 100.0, 0.08)
    return bench


def _ours(ticks: int, rate: float, tick: Step = bool, warm_up: Step | None = None) -> Paced:
    pacing = Pacing()
    clock = WallClock(round(pacing.spin_us * 1e3))
    wait = WarmUp(warm_up, clock, round(pacing.dry_run_us * 1e3)) if warm_up else clock
    restore = prepare_process(pacing, print)
    try:
        return paced(ticks, rate, wait.until, tick)
    finally:
        restore()


RATE = 50.0  # Hz
SECONDS = 3.0  # of each loop in each round
WARM_CALLS = 2000  # of each observation in each round, 20 in a sample
HISTORY = 6
USUAL, OURS = "policy tick, usual", "policy tick, unicon"
NATIVE = "policy tick, native"
ALONE = "network alone, in our loop"
CHUNK_RATE = 100.0  # Hz
CHUNK = ChunkSpec(10, steps=5)
BESIDE, BESIDE_NONE = "tick of chunks, beside a child", "tick of chunks, beside none"


def run_policy(rounds: int = 5) -> Bench:
    """Run the comparison.

    Args:
        rounds: interleaved rounds.
    """
    bench = Bench("policy", rounds)
    robot = load_robot("go2")
    with tempfile.TemporaryDirectory() as folder:
        contract = random_policy(Path(folder) / "one", robot)
        longer = random_policy(Path(folder) / "history", robot, history=HISTORY)
        _observations(bench, robot, contract, longer)
        _ticks(bench, robot, contract)
        _memory(bench, robot, contract, Path(folder) / "recurrent")
        _chunks(bench, robot, Path(folder) / "chunks")
    _scans(bench, robot)
    return bench


def _states(contract: PolicyContract, robot: Robot) -> States:
    states = States(
        {**standard_states(robot.joint_names), **policy_states(contract, robot.joint_names)}
    )
    random = np.random.default_rng(0)
    for name in ("joint_pos", "joint_vel", "base_ang_vel", "velocity_command"):
        states[name][...] = random.normal(size=states[name].shape)
    return states


def _concatenation(states: States, contract: PolicyContract) -> Callable[[], Float32]:
    """Return the usual observation: one expression for each term, `np.concatenate`, `np.clip`."""
    default = contract.default_joint_pos.copy()
    ang_vel, gravity = states["base_ang_vel"], states["projected_gravity"]
    command, action = states["velocity_command"], states["action"]
    pos, vel = states["joint_pos"], states["joint_vel"]
    policy_from_robot = np.arange(len(default))

    def assemble() -> Float32:
        observation = np.concatenate(
            [
                ang_vel * 0.25,
                gravity,
                command * 2.0,
                (pos[policy_from_robot] - default) * 1.0,
                vel[policy_from_robot] * 0.05,
                action,
            ]
        )
        clipped: Float32 = np.clip(observation, -CLIP, CLIP)
        return clipped

    return assemble


def _observations(
    bench: Bench, robot: Robot, contract: PolicyContract, longer: PolicyContract
) -> None:
    states, states6 = _states(contract, robot), _states(longer, robot)
    one = Observation(contract, states, robot.joint_names)
    six = Observation(longer, states6, robot.joint_names)
    fused, fused6 = (o.bind(np.zeros((1, o.size), np.float32)) for o in (one, six))
    plain, frame = _concatenation(states, contract), _concatenation(states6, longer)
    frames = deque([frame()] * HISTORY, maxlen=HISTORY)

    def plain6() -> Float32:
        frames.append(frame())
        return np.concatenate(frames)

    calls = {
        "observation: fused": fused,
        "observation: concatenate": plain,
        "observation, history 6: fused": fused6,
        "observation, history 6: concatenate": plain6,
    }
    times = Samples()
    for _ in range(bench.rounds):
        for name, call in calls.items():  # each by itself, so that it is warm
            times.take({name: call}, WARM_CALLS // 20, 20)
    times.add_to(bench)


def _ticks(bench: Bench, robot: Robot, contract: PolicyContract) -> None:
    policy = Policy(contract, _states(contract, robot), robot)
    alone = Policy(contract, _states(contract, robot), robot).lane.infer
    states = _states(contract, robot)
    native = NativeTick(states, print).compile(as_block(Policy(contract, states, robot)))
    loops: dict[str, Callable[[int], Paced]] = {
        USUAL: _usual_loop(robot, contract),
        OURS: lambda ticks: _ours(ticks, RATE, policy, policy.warm_up),
        NATIVE: lambda ticks: _ours(ticks, RATE, native.step, native.warm_up),
        ALONE: lambda ticks: _ours(ticks, RATE, alone, alone),
    }
    times = Samples()
    for _ in range(bench.rounds):
        for name, loop in loops.items():
            times.add(name, loop(round(RATE * SECONDS)).took)
    times.add_to(bench)


def _memory(bench: Bench, robot: Robot, contract: PolicyContract, folder: Path) -> None:
    """A recurrent policy beside the same network without its memory, in turns and warm."""
    recurrent = random_policy(folder, robot, recurrent=True)
    calls = {
        "policy call": Policy(contract, _states(contract, robot), robot),
        "policy call, recurrent": Policy(recurrent, _states(recurrent, robot), robot),
    }
    times = Samples()
    for _ in range(bench.rounds):
        times.take(calls, WARM_CALLS // 20, 20)
    times.add_to(bench)


class AtOnce(ChildNetwork):
    """In place of a child: zeros are there as soon as they are asked for, from no process.

    Args:
        child: whose network it stands for.
    """

    def __init__(self, child: ChildNetwork) -> None:
        self.what, self.culprit, self.number, self.warnings = child.what, "nobody", 0, []
        self.inputs, self.outputs = child.inputs, child.outputs
        self.reader: Any = self
        self.writer: Any = self

    def bind(self, inputs: Arrays, outputs: Arrays) -> Question:
        """Bind as a child does."""
        self.questions, self.answers = map(States, layouts_of(sides_of(inputs, outputs)))
        return Question(self, inputs.values(), outputs.values())

    def publish(self) -> None:
        """Answer."""
        self.answers["number"] = self.number

    def take(self) -> bool:
        """Say that the answer is there."""
        return True


def _chunks(bench: Bench, robot: Robot, folder: Path) -> None:
    """A policy by chunks at 10 Hz: its tick beside a child at work, and the same beside none.

    The tick has a core of its own and the child another one.
    """
    cores = sorted(os.sched_getaffinity(0))
    if len(cores) < 2:
        return
    contract = random_policy(folder, robot, hidden=(2048,) * 4, chunk=CHUNK.size)
    contract = replace(contract, child=ChildSpec(cpu=cores[-1]), chunk=CHUNK)
    given: Any = {"period": 1.0 / CHUNK_RATE, "paced": lambda: True}
    child = ChildPolicy(contract, _states(contract, robot), robot, **given)
    with closing(child):
        given["network"] = AtOnce(child.network)
        alone = ChildPolicy(contract, _states(contract, robot), robot, **given)
        times = Samples()
        os.sched_setaffinity(0, {cores[0]})
        try:
            for number in range(bench.rounds):
                for name, policy in [(BESIDE, child), (BESIDE_NONE, alone)][:: 1 - number % 2 * 2]:
                    policy.reset()
                    loop = _ours(round(CHUNK_RATE * SECONDS), CHUNK_RATE, policy, policy.warm_up)
                    times.add(name, loop.took)
                    times.add(f"{name}: wakes late", loop.late)
        finally:
            os.sched_setaffinity(0, cores)
        bench.facts["chunk_tick_p99, answers of the child"] = child.network.number
    times.add_to(bench)
    bench.facts["chunk_tick_p99, 95 % interval"] = interval(times.ratios(BESIDE, BESIDE_NONE, 99))


def _scans(bench: Bench, robot: Robot) -> None:
    """Height scans beside one call of `mj_multiRay` with as many rays on the same ground."""
    import mujoco

    spec, path, times = HeightScanSpec((1.6, 1.0), 0.1), pick_model(robot), Samples()
    states = States(standard_states(robot.joint_names) | {HEIGHT_SCAN: spec.state()})
    origin = states["base_pos_w"][...] = np.array((3.0, 0.0, 1.0))
    geoms, far = np.zeros(187, np.int32), np.zeros(187)
    rays = np.vstack((spec.points(), far - 1.0)).T.ravel()
    given = (origin, rays, None, True, 1, geoms, far, None, len(far), 100.0)
    flat = load_model(path, robot, quiet=True)
    calls: dict[str, Callable[[], object]] = {}
    for kind in ("flat", "rough"):
        terrain = read_terrain(kind, 0)
        laid = load_on(path, robot, terrain, flat=flat)
        data = mujoco.MjData(laid.model)
        mujoco.mj_forward(laid.model, data)
        calls[f"rays_{kind}"] = partial(mujoco.mj_multiRay, laid.model, data, *given)
        calls[f"scan_{kind}"] = HeightScan(spec, states, SceneGround(flat, terrain))
    calls["scan_by_rays"] = HeightScan(spec, states, RayHeights(laid))
    for _ in range(bench.rounds):
        times.take(calls, WARM_CALLS // 20, 5)
    times.add_to(bench)


def _usual_loop(robot: Robot, contract: PolicyContract) -> Callable[[int], Paced]:
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(
        str(contract.model), options, providers=["CPUExecutionProvider"]
    )
    states = _states(contract, robot)
    assemble = _concatenation(states, contract)
    target, action = states["joint_pos_target"], states["action"]
    default, scale = contract.default_joint_pos, np.float32(0.25)

    def tick() -> None:
        observation = assemble().astype(np.float32)[None]
        action[...] = session.run(None, {"obs": observation})[0][0]
        target[...] = default + scale * action

    return lambda ticks: paced(ticks, RATE, sleep_until, tick)
