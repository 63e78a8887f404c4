"""Block `reach`: joints of arms that bring end effectors to targets, by differential IK.

commands:
  - reach: {effectors: [left_hand, right_hand], moves: [arms], look_ahead: 0.06}
flow: {zip: [{policy: walk, drives: [legs, waist]}, {forward_command: {moves: [arms]}}]}
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from unicon_core.blocks.forward_command import MAX_RATE
from unicon_core.blocks.safety.limits import rates_of
from unicon_core.blocks.whole_body.frames import effector_of
from unicon_core.blocks.whole_body.reaching import COMMANDED, HELD, Reach, told_of
from unicon_core.bounds import within
from unicon_core.errors import MissingDependencyError, WorkflowError
from unicon_core.flow.block import Block, Reads, Writes
from unicon_core.ik.chain import Chain
from unicon_core.ik.differential import DifferentialIk
from unicon_core.ik.pairs import Reaching, load_apart
from unicon_core.ik.settings import APART, Settings, Weights
from unicon_core.ik.targets import LONGEST, Target
from unicon_core.models.find import model_of
from unicon_core.robots import Robot
from unicon_core.states import StateSpec
from unicon_core.states.effectors import target_of, target_states
from unicon_core.states.standard import forwarded_states
from unicon_core.workflow.autowire import BuildContext

View = NDArray[Any]
Effectors = Sequence[str] | Mapping[str, Mapping[str, float]]

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
    look_ahead: float = 0.0,
    max_rate: float | Literal["robot"] = MAX_RATE,
    posture: float = Settings.posture,
    apart: float = APART,
    tolerance: float = Settings.tolerance[0],
    angle_tolerance: float = Settings.tolerance[1],
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
            carries it, or an option is wrong.
        RobotError: the model lacks a body that the robot file names.
        ModelError: there is no model.
        MissingDependencyError: MuJoCo or daqp is not installed.
    """
    if joint_pos.ndim != 1:
        raise WorkflowError("it moves one robot; leave num_robots out, or leave it out")
    robot, states = context.robot, context.states
    weights = _weights(robot, effectors)
    settings = Settings(
        within(posture, "posture", "", 1.0, above=False),
        within(apart, "apart", "m", 0.5, above=False),
        (
            within(tolerance, "tolerance", "m", 1.0),
            within(angle_tolerance, "angle_tolerance", "rad", 3.2),
        ),
    )
    look_ahead = within(look_ahead, "look_ahead", "s", LONGEST, above=False) + context.lag
    rate = rates_of(max_rate, robot, "reach")
    moved = robot.group(list(moves))
    reaching = _loaded(context, list(weights), moved, settings.apart)
    reads = [name for effector in weights for name in target_of(effector)]
    writes = [name for effector in weights for name in told_of(effector)]
    views = {"joint_pos": joint_pos, "joint_vel": joint_vel, "stamp_ns": stamp_ns}
    views |= {name: states[name] for name in (*HELD, *reads)}
    outs = dict(zip(COMMANDED, (joint_pos_command, joint_vel_command)))
    outs |= {name: states[name] for name in writes}

    def make(
        ins: Mapping[str, View], results: Mapping[str, View], tell: Callable[[str], None]
    ) -> Reach:
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

    tick = make(views, outs, context.tell)
    tick.moves = tuple(moves)
    tick.notes = tuple(
        f"capsules {one} and {other} are not kept apart: at the default pose they are "
        f"{1e3 * distance:.0f} mm from each other"
        for one, other, distance in reaching.left_out
    )
    return Block(
        "",
        tick,
        reads=tuple(reads),
        writes=tuple(writes),
        reset=tick.reset,
        warm_up=_warm_up(make, views, outs),
        endless=True,
    )


def _declares(robot: Robot, effectors: Effectors = (), **_: Any) -> dict[str, StateSpec]:
    specs = forwarded_states(robot.joint_names)
    for effector in _weights(robot, effectors):
        specs |= target_states(effector) | told_of(effector)
    return specs


setattr(reach, "declares", _declares)  # noqa: B010  a function has none to mypy


def _weights(robot: Robot, effectors: Any) -> dict[str, Weights]:
    """Return the weights of each end effector that an option names.

    Raises:
        WorkflowError: one is unknown, or its weights are none.
    """
    named = effectors if isinstance(effectors, (Mapping, list, tuple)) else [effectors]
    found = {}
    for name in named:
        effector_of(str(name), robot, "reach")
        said = effectors[name] if isinstance(effectors, Mapping) else {}
        if not isinstance(said, Mapping) or not set(said) <= {"position", "orientation"}:
            raise WorkflowError(
                f"block 'reach': effectors.{name} is {said!r:.60}; give {{position: 1.0, "
                "orientation: 0.3}, weights of 1 m and 1 rad"
            )
        weights = Weights(
            **{
                key: within(w, f"effectors.{name}.{key}", "", 100.0, above=False)
                for key, w in said.items()
            }
        )
        if not weights.position and not weights.orientation:
            raise WorkflowError(
                f"block 'reach': effectors.{name} is free; give it a weight above 0"
            )
        found[str(name)] = weights
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


def _warm_up(
    make: Callable[[Mapping[str, View], Mapping[str, View], Callable[[str], None]], Reach],
    views: Mapping[str, View],
    outs: Mapping[str, View],
) -> Callable[[], None]:
    """Return what runs the same code on copies, and tells nothing."""
    copies = {name: view.copy() for name, view in views.items()}
    second = make(copies, {name: view.copy() for name, view in outs.items()}, _quiet)
    pairs = [(copies[name], view) for name, view in views.items()]

    def warm_up() -> None:
        for copy, view in pairs:
            copy[...] = view
        second()

    return warm_up


def _quiet(_: str) -> None:
    """Say nothing."""
