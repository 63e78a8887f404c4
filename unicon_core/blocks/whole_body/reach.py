"""Block `reach`: joints of arms that bring end effectors to targets, by differential IK.

commands:
  - reach: {effectors: [left_hand, right_hand], moves: [arms], look_ahead: 0.06}
flow: {zip: [{policy: walk, drives: [legs, waist]}, {forward_command: {moves: [arms]}}]}
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.blocks.forward_command import MAX_RATE
from unicon_core.blocks.joint_command import single
from unicon_core.blocks.robot_model import twice
from unicon_core.blocks.safety.limits import rates_of
from unicon_core.blocks.whole_body.frames import effector_of
from unicon_core.blocks.whole_body.reaching import COMMANDED, HELD, Reach, told_of
from unicon_core.bounds import MaxRate
from unicon_core.errors import MissingDependencyError, WorkflowError
from unicon_core.flow.block import Block, Reads, Writes
from unicon_core.ik.chain import Chain, Reaching, load_apart
from unicon_core.ik.differential import DifferentialIk
from unicon_core.ik.tasks import APART, LONGEST, Settings, Target, Weights
from unicon_core.models.find import model_of
from unicon_core.robots import Robot
from unicon_core.schema.marks import Unit, Within, Write
from unicon_core.states import StateSpec
from unicon_core.states.effectors import target_of, target_states
from unicon_core.states.standard import forwarded_states
from unicon_core.workflow.autowire import BuildContext

View = NDArray[Any]
Effectors = (
    Sequence[str] | Mapping[str, Annotated[Weights, Write("{position: 1.0, orientation: 0.3}")]]
)

_ARMS = "arms"


def reach(
    joint_pos: Reads,
    joint_vel: Reads,
    stamp_ns: Reads,
    joint_pos_command: Writes,
    joint_vel_command: Writes,
    *,
    context: BuildContext,
    effectors: Effectors,
    moves: Sequence[str] = (_ARMS,),
    look_ahead: Annotated[float, Unit("s"), Within(0.0, LONGEST)] = 0.0,
    max_rate: MaxRate = MAX_RATE,
    posture: Annotated[float, Within(0.0, 1.0)] = Settings.posture,
    apart: Annotated[float, Unit("m"), Within(0.0, 0.5)] = APART,
    tolerance: Annotated[float, Unit("m"), Within(0.0, 1.0, above=True)] = Settings.tolerance[0],
    angle_tolerance: Annotated[
        float, Unit("rad"), Within(0.0, 3.2, above=True)
    ] = Settings.tolerance[1],
) -> Block:
    """Command the joints that bring end effectors to their targets.

    Where an end effector has no target (NaN), the joints that carry no other one are not commanded.
    Other joints of the robot stand where they are measured.

    Args:
        joint_pos: measured, in [rad], shape (n,).
        joint_vel: measured, in [rad/s], shape (n,): on another part than the robot's, joints that
            it does not move are brought on by a tick, and targets too.
        stamp_ns: time of the robot's data.
        joint_pos_command: in [rad], shape (n,); NaN of what is not commanded.
        joint_vel_command: in [rad/s], likewise.
        effectors: names of the robot file's `end_effectors`, or name to `position` and
            `orientation`, their weights; 0 leaves one free.
        moves: groups, and joints or patterns of them, that it moves.
        look_ahead: in [s], by which targets are brought on by their velocity.
        max_rate: of a joint in [rad/s], or `robot` for the robot file's velocity limits.
        posture: weight of 1 rad to the default pose, against an end effector's 1 m.
        apart: distance in [m] that the robot file's capsules keep; 0 lets them touch.
        tolerance: in [m], within which a target counts as reached.
        angle_tolerance: in [rad], likewise.

    Raises:
        WorkflowError: the states are of a batch, an end effector is unknown or no moved joint
            carries it.
        RobotError: the model lacks a body that the robot file names.
        ModelError: there is no model.
        MissingDependencyError: MuJoCo or daqp is not installed.
    """
    single(joint_pos)
    robot, states = context.robot, context.states
    weights = _weights(robot, effectors)
    settings = Settings(posture, apart, (tolerance, angle_tolerance))
    look_ahead += context.lag
    rate = rates_of(max_rate, robot, "reach")
    moved = robot.group(list(moves))
    reaching = _loaded(context, list(weights), moved, settings.apart)
    reads = [name for effector in weights for name in target_of(effector)]
    writes = [name for effector in weights for name in told_of(effector)]
    views = {"joint_pos": joint_pos, "joint_vel": joint_vel, "stamp_ns": stamp_ns}
    views |= {name: states[name] for name in (*HELD, *reads)}
    outs = dict(zip(COMMANDED, (joint_pos_command, joint_vel_command)))
    outs |= {name: states[name] for name in writes}

    def make(ins: Mapping[str, View], results: Mapping[str, View]) -> Reach:
        tell = context.tell if results is outs else _quiet
        chain = Chain(reaching.loaded, robot, list(weights), moved)
        ik = DifferentialIk(
            chain,
            robot,
            list(weights.values()),
            rate[moved].astype(np.float64),
            context.period,
            settings,
        )
        targets = []
        for name, weight in weights.items():
            pose, velocity, stamp = (ins[state] for state in target_of(name))
            turns = weight.orientation > 0.0
            targets.append(Target(name, pose, velocity, stamp, turns, look_ahead, tell))
        told = context.period, tell, context.lag
        return Reach(ik, chain, list(weights), targets, ins, results, *told)

    tick, second, refresh = twice(make, views, outs)
    tick.moves = tuple(moves)
    tick.notes = tuple(
        f"capsules {one} and {other} are not kept apart: at the default pose they are "
        f"{1e3 * distance:.0f} mm from each other"
        for one, other, distance in reaching.left_out
    )

    def warm_up() -> None:
        refresh()
        second()

    return Block(
        "",
        tick,
        reads=tuple(reads),
        writes=tuple(writes),
        reset=tick.reset,
        warm_up=warm_up,
        endless=True,
    )


def _declares(robot: Robot, effectors: Effectors = (), **_: Any) -> dict[str, StateSpec]:
    specs = forwarded_states(robot.joint_names)
    for effector in _weights(robot, effectors):
        specs |= target_states(effector) | told_of(effector)
    return specs


setattr(reach, "declares", _declares)  # noqa: B010  a function has none to mypy


def _weights(robot: Robot, effectors: Effectors) -> dict[str, Weights]:
    """Return the weights of each end effector that an option names.

    Raises:
        WorkflowError: one is unknown, or its weights are 0.
    """
    found = {}
    for name in effectors:
        effector_of(name, robot, "reach")
        weights = found[name] = effectors[name] if isinstance(effectors, Mapping) else Weights()
        if not weights.position and not weights.orientation:
            raise WorkflowError(
                f"block 'reach': effectors.{name} is free; give it a weight above 0"
            )
    if not found:
        known = ", ".join(robot.end_effectors) or f"add some to {robot.path}"
        raise WorkflowError(f"block 'reach': effectors names none; known: {known}")
    return found


def _loaded(
    context: BuildContext, effectors: Sequence[str], moved: NDArray[np.intp], apart: float
) -> Reaching:
    robot = context.robot
    path = model_of(None if context.carried else context.platform, robot)
    try:
        return load_apart(path, robot, effectors, moved, apart)
    except MissingDependencyError as error:
        raise MissingDependencyError(
            "block 'reach'", "mujoco", "pip install 'unicon_ros[sim]'"
        ) from error


def _quiet(_: str) -> None:
    """Say nothing."""
