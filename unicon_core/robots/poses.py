"""Poses by name or by joint, for posture blocks and for the beginning of a simulation."""

from __future__ import annotations

from collections.abc import Mapping
from fnmatch import fnmatchcase

import numpy as np
from numpy.typing import NDArray

from unicon_core.bounds import POSITION, within
from unicon_core.errors import RobotError, WorkflowError, alternatives
from unicon_core.robots.robot import Robot

Float = NDArray[np.float32]


def robot_poses(robot: Robot) -> dict[str, Float]:
    """Return word to pose of a robot file in [rad], shape (n,), NaN where it does not say it."""
    standing, lying = robot.default_joint_pos, robot.rest_joint_pos
    return {"default": standing, "stand": standing, "rest": lying, "lie": lying}


def joints_like(pattern: str, robot: Robot, remedy: str = "") -> list[int]:
    """Return the joints whose names match a pattern with `*` and `?`, never empty.

    Args:
        pattern: of names.
        robot: whose joints.
        remedy: where the caller knows more of one than the names.

    Raises:
        WorkflowError: none does.
    """
    found = [i for i, name in enumerate(robot.joint_names) if fnmatchcase(name, pattern)]
    if not found:
        raise WorkflowError(
            f"robot {robot.name} has no joint like {pattern!r}; "
            f"{alternatives(pattern, robot.joint_names)}{f'; {remedy}' if remedy else ''}"
        )
    return found


def named_pose(to: str | Mapping[str, float], robot: Robot, what: str) -> tuple[Float, Float]:
    """Return a pose [rad] and which joints it says (1 or 0), each shape (n,).

    Args:
        robot: whose pose.
        what: asks for it, for the message.
        to: `stand` or `default`, `rest` or `lie`, or joint names and patterns to [rad].

    Raises:
        RobotError: the robot file does not say that pose.
        WorkflowError: no such pose or joint, or a position beyond the joint's limits.
    """
    if isinstance(to, str):
        poses = robot_poses(robot)
        if to not in poses:
            raise WorkflowError(f"no pose {to!r}; {alternatives(to, poses)}; or joints to [rad]")
        if np.isnan(poses[to]).any():
            key = "default" if poses[to] is robot.default_joint_pos else "rest"
            first, *more = np.flatnonzero(np.isnan(poses[to])).tolist()
            joint = robot.joint_names[first]
            also = f" and {len(more)} more joint{'s' * (len(more) > 1)}" if more else ""
            raise RobotError(
                f"{what}: robot {robot.name} does not say `{key}` (the {to} pose) of {joint}"
                f"{also}; give it in {robot.file_of(joint)}, or give joints and positions"
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
