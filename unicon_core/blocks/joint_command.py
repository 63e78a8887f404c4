"""What the posture blocks share: the command states, the robot's gains, joints by pattern."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.bounds import GAIN_SCALES, POSITION, within
from unicon_core.errors import RobotError, WorkflowError, alternatives
from unicon_core.flow.block import Bundle, Reads, Writes
from unicon_core.robots import Robot

__all__ = ["LONGEST_S", "JointCommand", "joints_like", "named_pose", "robot_gains", "ticks_of"]

Float = NDArray[np.float32]

LONGEST_S = 1e9
"""Longest time that a block counts in [s]: thirty years."""


@dataclass(frozen=True, eq=False)
class JointCommand(Bundle):
    """The command states of the tick and where the joints are, each of shape (..., n).

    Attributes:
        joint_pos: measured positions in [rad].
        joint_pos_target: in [rad].
        joint_vel_target: in [rad/s].
        joint_effort_ff: in [N·m].
        joint_stiffness: in [N·m/rad].
        joint_damping: in [N·m·s/rad].
    """

    joint_pos: Reads
    joint_pos_target: Writes
    joint_vel_target: Writes
    joint_effort_ff: Writes
    joint_stiffness: Writes
    joint_damping: Writes

    def entry(self, out: NDArray[Any]) -> None:
        """Write where a movement begins in [rad], shape (..., n).

        A joint that holds a target begins there, so that the torque does not jump; a limp one
        (stiffness 0) begins where it was measured.
        """
        out[...] = np.where(self.joint_stiffness > 0.0, self.joint_pos_target, self.joint_pos)


def robot_gains(
    robot: Robot, needed_for: str, stiffness_scale: float = 1.0, damping_scale: float = 1.0
) -> tuple[Float, Float]:
    """Return the stiffness [N·m/rad] and damping [N·m·s/rad] of a robot file, each shape (n,).

    A robot whose vendor closes the position loop has none: 1 then stands for "on".

    Args:
        robot: the robot.
        needed_for: the block, for the message.
        stiffness_scale: factor on the stiffness.
        damping_scale: factor on the damping.

    Raises:
        RobotError: a gain is unknown.
        WorkflowError: a factor is not plausible.
    """
    gains = []
    for key, values, scale in (
        ("stiffness", robot.joint_stiffness, stiffness_scale),
        ("damping", robot.joint_damping, damping_scale),
    ):
        option = f"{key}_scale"
        scale = within(scale, option, "", GAIN_SCALES[option], above=False)
        known = np.where(np.isnan(values), 1.0, values) if robot.position_controlled else values
        unknown = [name for name, value in zip(robot.joint_names, known) if math.isnan(value)]
        if unknown:
            raise RobotError(
                f"block {needed_for!r}: robot {robot.name} does not say the {key} of joint "
                f"{unknown[0]} ({len(unknown)} joints); give it in {robot.path}"
            )
        gains.append(known.astype(np.float32) * np.float32(scale))
    return gains[0], gains[1]


def joints_like(pattern: str, robot: Robot) -> list[int]:
    """Return the joints whose names match a pattern with `*` and `?`, never empty.

    Raises:
        WorkflowError: none does.
    """
    found = [i for i, name in enumerate(robot.joint_names) if fnmatchcase(name, pattern)]
    if not found:
        raise WorkflowError(
            f"robot {robot.name} has no joint like {pattern!r}; "
            f"{alternatives(pattern, robot.joint_names)}"
        )
    return found


def named_pose(to: str | Mapping[str, float], robot: Robot, block: str) -> tuple[Float, Float]:
    """Return a pose [rad] and which joints it says (1 or 0), each shape (n,).

    Args:
        to: `stand` or `default`, `rest` or `lie`, or joint names and patterns to [rad].

    Raises:
        RobotError: the robot file does not say that pose.
        WorkflowError: no such pose or joint, or a position beyond the joint's limits.
    """
    if isinstance(to, str):
        poses = {
            "default": robot.default_joint_pos,
            "stand": robot.default_joint_pos,
            "rest": robot.rest_joint_pos,
            "lie": robot.rest_joint_pos,
        }
        if to not in poses:
            raise WorkflowError(f"no pose {to!r}; {alternatives(to, poses)}; or joints to [rad]")
        if np.isnan(poses[to]).any():
            joint = robot.joint_names[int(np.argmax(np.isnan(poses[to])))]
            raise RobotError(
                f"block {block!r}: robot {robot.name} does not say the {to} pose of joint {joint}; "
                f"give it in {robot.path}, or give the block joints and positions"
            )
        return poses[to].astype(np.float32), np.ones(robot.num_joints, np.float32)
    pose = np.zeros(robot.num_joints, np.float32)
    said = np.zeros(robot.num_joints, np.float32)
    for pattern, position in to.items():
        within(position, f"position of {pattern!r}", "rad", POSITION, -POSITION, above=False)
        for i in joints_like(pattern, robot):
            lower, upper = robot.lower[i], robot.upper[i]
            if position < lower - 1e-6 or position > upper + 1e-6:  # false for an unknown limit
                raise WorkflowError(
                    f"{position} rad is beyond the limits of joint {robot.joint_names[i]}: "
                    f"{lower:.6g} to {upper:.6g} rad; correct the pose"
                )
            pose[i], said[i] = position, 1.0
    return pose, said


def ticks_of(seconds: float | None, period: float, option: str) -> int | None:
    """Return a time as a number of ticks, at least 1; None for no end.

    Raises:
        WorkflowError: it is no time.
    """
    if seconds is None:
        return None
    number = isinstance(seconds, (int, float)) and not isinstance(seconds, bool)
    if not number or not 0.0 <= seconds <= LONGEST_S:
        raise WorkflowError(
            f"{option} is {seconds!r}; give a time from 0 to {LONGEST_S:g} in [s], or leave it out"
        )
    return max(round(seconds / period), 1)
