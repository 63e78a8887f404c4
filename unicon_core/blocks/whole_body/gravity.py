"""Block `gravity`: carries the robot's own arms, so that they do not sag below their targets.

    flow: {zip: [{forward_command: {moves: [arms]}}, {gravity: {moves: [arms]}}]}

A servo holds against a weight only by an error: torque = stiffness · error. With the weight fed
forward it needs none.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from unicon_base.arrays import Bool, Index
from unicon_base.errors import WorkflowError
from unicon_core.blocks.joint_command import single
from unicon_core.flow.block import Amends, Reads
from unicon_core.models.loaded import index_of
from unicon_core.models.posed import Weight, bearing_joints
from unicon_core.robots import Robot
from unicon_core.workflow.autowire import BuildContext


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
            free = [name for name, joints in robot.groups.items() if not _any(robot, joints, wrong)]
            others = f", such as {' or '.join(free)}" if free else ""
            raise WorkflowError(f"{robot.joint_names[bad[0]]} {why}; name others in moves{others}")
    return places


def _any(robot: Robot, joints: Sequence[str], of: Bool) -> bool:
    return any(of[robot.joint_names.index(name)] for name in joints)
