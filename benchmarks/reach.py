"""`unicon bench reach`: a step of both hands of a G1, ours beside mink's, in interleaved rounds.

Hands go round in circles, and are pushed through each other at 2 and at 6 rad/s, with the distance
of the robot's capsules kept and without. Both sides have the same model,
joints, weights, limits and solver. Without mink ours are measured alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from importlib.util import find_spec
from typing import Any

import numpy as np

from benchmarks.samples import Samples, timed
from unicon_base.arrays import Array, Float64
from unicon_core.models.find import pick_model
from unicon_core.models.loaded import import_mujoco
from unicon_core.robots import Robot, load_robot
from unicon_manipulation.ik.chain import (
    CAPSULE,
    FRAME,
    Chain,
    Pair,
    Reaching,
    add_reaching,
    load_apart,
)
from unicon_manipulation.ik.differential import Apart, DifferentialIk
from unicon_manipulation.ik.tasks import Pose, Settings, Weights
from unicon_ros.bench.report import Bench

ROBOT, HANDS, MOVES = "g1_29dof", ("left_hand", "right_hand"), ("arms",)
PERIOD, TICKS, APART = 0.02, 250, 0.02
RATES = (2.0, 6.0)
SETTLED = 50
"""Ticks after which hands are on their circles."""


class _Ours:
    """Both arms by our own inverse kinematics; the methods are those of `MinkArms`."""

    def __init__(self, robot: Robot, reaching: Reaching, rate: float, apart: float) -> None:
        moved = robot.group(MOVES)
        chain = Chain(reaching.loaded, robot, HANDS, moved)
        rates, settings = np.full(len(moved), rate), Settings(apart=apart)
        self.ik = DifferentialIk(chain, robot, [Weights()] * 2, rates, PERIOD, settings)
        self._pose = robot.default_joint_pos.astype(np.float64)
        self._all = np.ones(len(moved), np.bool_)

    @property
    def pos(self) -> Float64:
        return self.ik.pos

    def begin(self, pos: Float64) -> None:
        self.ik.begin(pos, self._all)

    def __call__(self, targets: Sequence[Pose]) -> None:
        self.ik(self._pose, targets)


class _Watch:
    """Tells where hands are and how near capsules, no matter what moved the arms."""

    def __init__(self, robot: Robot, reaching: Reaching) -> None:
        self._chain = Chain(reaching.loaded, robot, HANDS, robot.group(MOVES))
        self._apart = Apart(self._chain, 1.0, 0.0)
        self.pose = robot.default_joint_pos.astype(np.float64)
        self.start = self.pose[robot.group(MOVES)]
        self.homes = [tuple(map(tuple, self._at(self.start, i))) for i in range(2)]

    def _at(self, pos: Float64, hand: int) -> Any:
        self._chain.put(self.pose, pos)
        return self._chain.frame(hand)

    def error(self, pos: Float64, targets: Sequence[Pose]) -> list[float]:
        """Return how far each hand is from its target in [m]."""
        return [math.dist(self._at(pos, i)[0], targets[i][0]) for i in range(2)]

    def nearest(self, pos: Float64) -> float:
        """Return the least distance of two capsules in [m]."""
        self._chain.put(self.pose, pos)
        self._chain.differentiate()
        return float(self._apart.rows()[0].min())


def run(rounds: int = 5) -> Bench:
    """Run the comparison.

    Args:
        rounds: interleaved rounds.
    """
    bench = Bench("reach", rounds)
    robot = load_robot(ROBOT)
    path, moved = pick_model(robot), robot.group(MOVES)
    bare, kept = (load_apart(path, robot, HANDS, moved, apart) for apart in (0.0, APART))
    watch = _Watch(robot, load_apart(path, robot, HANDS, moved, APART))
    times, errors, nearest = Samples(), Samples(), Samples()
    ours: list[_Ours] = []
    for rate in RATES:
        pair = _Ours(robot, bare, rate, 0.0), _Ours(robot, kept, rate, APART)
        ways: dict[str, _Ours | MinkArms] = dict(zip(("ours", "ours, apart"), pair))
        ours += pair
        if find_spec("mink"):
            for name, pairs in (("mink", ()), ("mink, apart", kept.pairs)):
                ways[name] = MinkArms(robot, rate, pairs)
        motions = [*["circles"] * (rate == RATES[-1]), f"crossing, {rate:g} rad/s"]
        for motion in motions * bench.rounds:
            wanted = [_targets(motion, i, watch.homes) for i in range(TICKS)]
            for name, way in ways.items():
                took, poses = [], []
                way.begin(watch.start)
                for targets in wanted:
                    took.append(timed(way, targets))
                    poses.append(way.pos.copy())
                case = f"{motion}: {name}"
                times.add(case, took)
                if motion == "circles":
                    after = list(zip(poses, wanted))[SETTLED:]
                    errors.add(case, [error for each in after for error in watch.error(*each)])
                else:
                    nearest.add(case, min(map(watch.nearest, poses)))
    times.add_to(bench)
    for name in errors.names:
        of_all = 1e3 * errors.of(name)
        middle, most = np.percentile(of_all, 50), of_all.max()
        bench.facts[f"{name}: error [mm], p50 and max"] = f"{middle:.2g}, {most:.2g}"
    for name in nearest.names:
        bench.facts[f"{name}: least distance [mm]"] = round(1e3 * nearest.of(name).min(), 1)
    bench.facts["solver failures"] = sum(each.ik.failures for each in ours)
    if not find_spec("mink"):
        bench.facts["mink"] = "left out: pip install mink"
    closest = min(nearest.of(name).min() for name in nearest.names if "ours, apart" in name)
    bench.ratio("crossing_mm", 1e3 * float(closest), 10.0, at_least=True)
    return bench


def _targets(motion: str, tick: int, homes: Sequence[Any]) -> list[Pose]:
    """Return where the hands shall be in a tick."""
    angle = 2.0 * math.pi * 0.4 * tick * PERIOD
    found: list[Pose] = []
    for (x, y, z), quat in homes:
        if motion == "circles":
            place = (x, y + 0.08 * math.sin(angle), z + 0.1 + 0.08 * math.cos(angle))
        else:
            place = (x, y * math.cos(angle), z)
        found.append((place, quat))
    return found


class MinkArms:
    """One step of mink in each call.

    Args:
        robot: whose arms they are; joints of its model are called as in the robot file.
        rate: largest speed of a joint in [rad/s].
        pairs: of capsules that keep `APART`; none for no such limit.

    Attributes:
        pos: where the moved joints are commanded, in [rad], shape (k,).
    """

    def __init__(self, robot: Robot, rate: float, pairs: Sequence[Pair] = ()) -> None:
        import mink

        self._mink, moved = mink, robot.group(MOVES)
        names = [robot.joint_names[i] for i in moved]
        model = _arms_of(robot, names)
        self._configuration = mink.Configuration(model)
        self._tasks = [
            mink.FrameTask(FRAME + name, "body", position_cost=1.0, orientation_cost=0.3)
            for name in HANDS
        ]
        posture = mink.PostureTask(model, cost=0.02, gain=0.01)
        posture.set_target(model.qpos0)
        self._all = [*self._tasks, posture]
        self._limits = [
            mink.ConfigurationLimit(model),
            mink.VelocityLimit(model, dict.fromkeys(names, rate)),
        ]
        if pairs:
            self._limits.append(
                mink.CollisionAvoidanceLimit(
                    model,
                    [([CAPSULE + one], [CAPSULE + other]) for one, other in pairs],
                    minimum_distance_from_collisions=APART,
                    collision_detection_distance=0.08 + APART,
                )
            )
        self._index = [int(model.joint(name).qposadr[0]) for name in names]
        self.begin(robot.default_joint_pos[moved])

    def begin(self, pos: Array) -> None:
        """Begin where the moved joints are, in [rad], shape (k,)."""
        start = np.zeros(len(self._index))
        start[self._index] = pos
        self._configuration.update(start)

    @property
    def pos(self) -> Float64:
        found: Float64 = self._configuration.q[self._index]
        return found

    def __call__(self, targets: Sequence[Pose]) -> None:
        """Move on by one step towards a target of each end effector."""
        mink, configuration = self._mink, self._configuration
        for task, (position, quat) in zip(self._tasks, targets):
            task.set_target(mink.SE3(np.array([*quat, *position])))
        velocity = mink.solve_ik(
            configuration, self._all, PERIOD, "daqp", damping=1e-4, limits=self._limits
        )
        configuration.integrate_inplace(velocity, PERIOD)


def _arms_of(robot: Robot, names: Sequence[str]) -> Any:
    """Return the model with some joints alone; the others stand at the default pose."""
    mujoco, path = import_mujoco(), pick_model(robot)
    spec = mujoco.MjSpec.from_file(str(path))
    add_reaching(spec, robot, HANDS, path)
    for geom in spec.geoms:
        if geom.name.startswith(CAPSULE):  # mink leaves out what cannot touch
            geom.contype = geom.conaffinity = 1
    root = spec.worldbody.first_body()
    root.pos, root.quat = [0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]
    for each in (*spec.actuators, *spec.sensors, *spec.keys):
        spec.delete(each)
    default = dict(zip(robot.joint_names, robot.default_joint_pos.tolist()))
    for joint in list(spec.joints):
        if joint.name in names:
            continue
        if joint.name in default:
            _turn(mujoco, joint.parent, joint.axis, default[joint.name])
        spec.delete(joint)
    return spec.compile()


def _turn(mujoco: Any, body: Any, axis: Any, angle: float) -> None:
    """Turn a body about an axis of its own, as its joint at the body's origin would."""
    turn, turned = np.zeros(4), np.zeros(4)
    mujoco.mju_axisAngle2Quat(turn, np.asarray(axis, np.float64), angle)
    mujoco.mju_mulQuat(turned, np.asarray(body.quat, np.float64), turn)
    body.quat = turned
