"""Poses by name or by joint, and what a simulator is told of joints.

scene: {joints: {RL_calf_joint: {strength: 0.5, friction: 2.0}, "*": {delay: 0.004}}}
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np

from unicon_base.arrays import Float32, Float64
from unicon_base.errors import RobotError, WorkflowError, alternatives
from unicon_base.schema.records import record_of
from unicon_core.bounds import POSITION, within
from unicon_core.robots.file import Figures
from unicon_core.robots.robot import Robot


def robot_poses(robot: Robot) -> dict[str, Float32]:
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


def named_pose(to: str | Mapping[str, float], robot: Robot, what: str) -> tuple[Float32, Float32]:
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


JOINT_PHYSICS = {name: field.type.unit for name, field in record_of(Figures).fields.items()}  # type: ignore[attr-defined]
"""Word to unit."""

Said = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True, eq=False)
class JointPhysics:
    """What is said of each joint: float64, shape (n,), NaN where the model's own value stays."""

    strength: Float64
    friction: Float64
    armature: Float64
    delay: Float64

    @property
    def words(self) -> list[str]:
        """What is said of any joint, in the order of `JOINT_PHYSICS`."""
        return [word for word in JOINT_PHYSICS if not np.isnan(getattr(self, word)).all()]


def joint_physics(robot: Robot, said: Said) -> JointPhysics:
    """Return what is said of a robot's joints: what the robot file says, then `said` over it.

    Args:
        robot: the robot.
        said: joint names and patterns to word and figure; of two that meet the later one counts.

    Raises:
        WorkflowError: no such joint.
    """
    arrays = {word: np.full(robot.num_joints, np.nan) for word in JOINT_PHYSICS}
    for each in (robot.simulated, said):
        for pattern, figures in each.items():
            joints = joints_like(pattern, robot)
            for word, figure in figures.items():
                arrays[word][joints] = figure
    return JointPhysics(**arrays)
