"""Blocks `frames` (poses of hands and other bodies), `moving_target` (on a circle) and `gravity`.

    estimate: [{frames: {of: [left_hand, right_hand]}}]     # left_hand_pose, right_hand_pose
    estimate: [{frames: {of: {palm: left_wrist_yaw_link}, frame: world}}]       # palm_pose
    commands: [{moving_target: {effector: left_hand, radius: 0.08, frequency: 0.4}}]
    flow: {zip: [{forward_command: {moves: [arms]}}, {gravity: {moves: [arms]}}]}

`gravity` carries the robot's own arms, so that they do not sag below their targets. A servo holds
against a weight only by an error: torque = stiffness · error. With the weight fed forward it needs
none.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal

import numpy as np

from unicon_base.arrays import Bool, Index
from unicon_base.errors import WorkflowError, alternatives
from unicon_base.schema.marks import Point, Within
from unicon_core.blocks.postures import single
from unicon_core.bounds import DURATION
from unicon_core.flow.block import Amends, Reads
from unicon_core.models.frames import Frames as BodyFrames
from unicon_core.models.loaded import index_of
from unicon_core.models.posed import Weight, bearing_joints
from unicon_core.robots import Robot, joint_index
from unicon_core.robots.robot import Place
from unicon_core.states import StateSpec
from unicon_core.states.layout import check_name
from unicon_core.states.standard import pose_of, pose_states, target_of, target_states
from unicon_core.workflow.autowire import BuildContext

Of = Sequence[str] | Mapping[str, str]


class Frames:
    """Tell the poses of end effectors, or of bodies, as states `NAME_pose`.

    Each is position in [m] and quaternion wxyz, shape (7,). Two neighbouring ticks have the
    quaternion of the same sign.

    Args:
        joint_pos: in [rad] or [m], shape (n,).
        of: end effectors of the robot file, all unless told; or names to bodies of the model.
        frame: `base`, or `world`, which takes `base_pos_w` and `base_quat`.

    Raises:
        WorkflowError: no such end effector, or the states are of a batch.
        ModelError: there is no model, or it lacks a body.
    """

    memory = ()

    def __init__(
        self,
        joint_pos: Reads,
        *,
        context: BuildContext,
        of: Of = (),
        frame: Literal["base", "world"] = "base",
    ) -> None:
        single(joint_pos)
        loaded = context.model("frames")
        states = context.states
        robot = context.robot
        places = _places(of, robot)
        self.reads: tuple[str, ...] = ()
        if frame == "world" and loaded.base is not None:
            self.reads = ("base_pos_w", "base_quat")
            if context.carried:
                raise WorkflowError(
                    "frame is 'world', and what carries this member is not known here; leave of: "
                    "out beside it, and name bodies of the whole"
                )
        self.writes = tuple(map(pose_of, places))
        self._frames = BodyFrames(loaded, robot, places)
        self._joint_pos = joint_pos
        self._outs = [states[name] for name in self.writes]
        self._base = [states[name] for name in self.reads]
        self._world = np.array((0, 0, 0, 1.0, 0, 0, 0)) if frame == "world" else None

    @staticmethod
    def declares(
        *, robot: Robot, of: Of = (), frame: str = "base", **_: Any
    ) -> dict[str, StateSpec]:
        """Return the states of the poses."""
        found: dict[str, StateSpec] = {}
        for name in _places(of, robot):
            found |= pose_states(name, frame)
        return found

    def __call__(self) -> None:
        if self._base and self._world is not None:
            self._world[:3], self._world[3:] = self._base
        self._frames(self._joint_pos, self._outs, self._world)


def effector_of(name: str, robot: Robot, block: str) -> Place:
    """Return an end effector of a robot file.

    Args:
        name: of the end effector.
        robot: whose it is.
        block: that asks, for the message.

    Raises:
        WorkflowError: it has none of that name.
    """
    known = robot.end_effectors
    if name in known:
        return known[name]
    remedy = alternatives(name, known) if known else "it names none"
    raise WorkflowError(
        f"block {block!r}: robot {robot.name} has no end effector {name!r}; {remedy}; name one "
        f"under end_effectors in {robot.path}"
    )


def _places(of: Of, robot: Robot) -> dict[str, Place]:
    if isinstance(of, Mapping):
        return {check_name(name): Place(body) for name, body in of.items()}
    words = tuple(of) or tuple(robot.end_effectors)
    if not words:
        raise WorkflowError(
            f"block 'frames': robot {robot.name} names no end effectors; give of: {{NAME: BODY}}, "
            f"or name them under end_effectors in {robot.path}"
        )
    return {word: effector_of(word, robot, "frames") for word in words}


LARGEST = 1.0
"""Radius in [m]: an arm is no longer."""
QUICKEST = 10.0
"""In [Hz]: a person shakes a hand at 5 to 8."""
PLANES = {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}


class MovingTarget:
    """Move an end effector's target on a circle in the base frame, from its centre on.

    The orientation is that of the end effector at the robot's default pose. Over `ramp` the radius
    grows from 0, as half a cosine; velocity and stamp are told with the target.

    Args:
        stamp_ns: source time of the robot's data, shape ().
        effector: of the robot file.
        centre: x, y, z in [m], or `default`: where it is at the robot's default pose.
        radius: in [m].
        frequency: in [Hz].
        plane: of the circle; it turns from the first axis to the second.
        ramp: in [s].

    Raises:
        WorkflowError: no such end effector, or the states are of a batch.
        ModelError: there is no model, or it lacks the body.
    """

    memory = ("_ticks",)

    endless = True

    def __init__(
        self,
        stamp_ns: Reads,
        *,
        context: BuildContext,
        effector: str,
        centre: Literal["default"] | Point = "default",
        radius: Annotated[float, Within(0.0, LARGEST, "m")] = 0.08,
        frequency: Annotated[float, Within(0.0, QUICKEST, "Hz")] = 0.4,
        plane: Literal["xy", "xz", "yz"] = "yz",
        ramp: Annotated[float, Within(0.0, DURATION, "s")] = 2.0,
    ) -> None:
        single(stamp_ns[..., None])
        robot = context.robot
        places = {effector: effector_of(effector, robot, "moving_target")}
        frames = BodyFrames(context.model("moving_target"), robot, places)
        middle = self._middle = frames.of(robot.default_joint_pos)[effector]
        if centre != "default":
            middle[:3] = centre
        if not np.isfinite(middle).all():
            raise WorkflowError(
                f"robot {robot.name} does not say its default pose; give centre: [x, y, z], and "
                f"the default of every joint in {robot.path}"
            )
        self.writes = target_of(effector)
        self._target, self._velocity, self._said = (context.states[name] for name in self.writes)
        self._stamp = stamp_ns
        self._radius = radius
        self._turn = 2.0 * math.pi * frequency
        self._axes = PLANES[plane]
        self._ramp = ramp
        self._period = context.period
        self._ticks = 0

    @staticmethod
    def declares(*, robot: Robot, effector: str = "", **_: Any) -> dict[str, StateSpec]:
        """Return the states of the target; without an end effector none, which the build tells."""
        if not effector:
            return {}
        effector_of(effector, robot, "moving_target")
        return target_states(effector)

    def __call__(self) -> None:
        time = self._ticks * self._period
        self._ticks += 1
        # r(t) = R (1 - cos πt/T) / 2, and its velocity.
        radius = self._radius
        grows = 0.0
        if time < self._ramp:
            angle = math.pi * time / self._ramp
            grows = 0.5 * math.pi / self._ramp * radius * math.sin(angle)
            radius *= 0.5 - 0.5 * math.cos(angle)
        target, velocity, middle, (i, j) = self._target, self._velocity, self._middle, self._axes
        c = math.cos(self._turn * time)
        s = math.sin(self._turn * time)
        target[:] = middle
        target[i], target[j] = middle[i] + radius * c, middle[j] + radius * s
        velocity[:] = 0.0
        velocity[i] = grows * c - radius * self._turn * s
        velocity[j] = grows * s + radius * self._turn * c
        self._said[...] = self._stamp

    def reset(self) -> None:
        """Begin at the centre again."""
        self._ticks = 0


class Gravity:
    """Add the torques that hold the robot's own links at rest, where they are measured.

    What the hands of a robot made of members weigh counts; what they grip does not: nobody knows
    it. Together with what was commanded they stay within the robot file's efforts.

    Args:
        joint_pos: in [rad] or [m], shape (n,).
        joint_effort_ff: in [N·m] or [N], shape (n,).
        moves: groups, joints or patterns of joints that are carried; of a robot without feet all
            whose vendor takes torques, unless told.

    Attributes:
        moves: groups or joints, for checks.
        torque: that was added last in [N·m], shape (n,).

    Raises:
        WorkflowError: a joint bears a foot or takes no torques, or a robot with feet is not told
            which to carry; the states are of a batch, or of a member that another one carries.
        RobotError: a word means no joint.
        ModelError: there is no model, or it lacks a joint.
    """

    memory = ("_others", "_left")

    endless = True

    def __init__(
        self,
        joint_pos: Reads,
        joint_effort_ff: Amends,
        *,
        context: BuildContext,
        moves: Sequence[str] = (),
    ) -> None:
        single(joint_pos)
        if context.carried:
            raise WorkflowError(
                "how the member is turned is not known here; leave of: out beside it, and name the "
                "member under moves"
            )
        robot = context.robot
        loaded = context.model("gravity")
        places = _carried(robot, tuple(moves), bearing_joints(loaded, robot))
        self.moves = tuple(moves) or tuple(robot.joint_names[place] for place in places)
        self._weight = Weight(loaded)
        self.reads = ("base_quat",) if self._weight.floats else ()
        self._quat = context.states["base_quat"] if self._weight.floats else None
        self._joint_pos = joint_pos
        self._effort = joint_effort_ff
        self._at = index_of(places.tolist())
        self._most = np.nan_to_num(robot.effort_limit, nan=np.inf)[self._at]
        self._least = -self._most
        self.torque = np.zeros(robot.num_joints)
        self._asked = np.zeros(robot.num_joints)
        # What other blocks ask for, and what this one left there in the last tick.
        self._others = np.zeros(len(places), np.float32)
        self._left = np.full(len(places), np.nan, np.float32)

    def __call__(self) -> None:
        asked, others, total = self._asked, self._others, self._left
        self._weight(self._joint_pos, asked, self._quat)
        if math.isfinite(float(asked.sum())):  # else what was measured makes no sense: the last
            self.torque[:] = asked
        # A policy of positions writes no torques: what was added last would be added to again.
        given = self._effort[self._at]
        np.copyto(others, given, where=given != total)
        np.add(others, self.torque[self._at], out=total)
        np.maximum(total, self._least, out=total)
        np.minimum(total, self._most, out=total)
        self._effort[self._at] = total


def _carried(robot: Robot, words: tuple[str, ...], bears: Bool) -> Index:
    """Return the joints that are carried, in the robot's order."""
    servo = robot.by_position
    if not words:
        if bears.any():  # with the waist carried, too, the G1 falls under its asset policy in 3 s
            raise WorkflowError(
                "a policy that walks was trained without it; name the joints that others move: "
                "moves: [arms]"
            )
        if servo.all():
            raise WorkflowError(
                f"every joint of {robot.name} takes positions alone: its vendor closes the loop; "
                "leave it out"
            )
        return np.flatnonzero(~servo)
    places = robot.group(words)
    for wrong, why in (
        (bears, "bears a foot: what it carries depends on the ground"),
        (servo, "takes positions alone: its vendor closes the loop"),
    ):
        bad = places[wrong[places]]
        if len(bad):
            free = [
                name
                for name, joints in robot.groups.items()
                if not wrong[joint_index(joints, robot.joint_names)].any()
            ]
            others = f", such as {' or '.join(free)}" if free else ""
            raise WorkflowError(f"{robot.joint_names[bad[0]]} {why}; name others in moves{others}")
    return places
