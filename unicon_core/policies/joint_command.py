"""From a network's action to targets of all joints, aligned by name, for policy blocks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import PolicyError, alternatives
from unicon_core.policies.contract import PolicyContract
from unicon_core.robots import Robot

__all__ = ["JointCommand"]

Floats = NDArray[np.float32]


class JointCommand:
    """`joint_pos_target = offset + scale · clip(action)`; other joints are held at default.

    Args:
        contract: the policy.
        robot: the robot that is to move.
        rows: number of robots.

    Attributes:
        stiffness: gain of every joint in the robot's order in [N·m/rad], shape (n,).
        damping: likewise in [N·m·s/rad].
        covered: which joints the network moves, shape (n,), bool.

    Raises:
        PolicyError: a joint the robot has not, or a held joint whose pose or gains are unknown.
    """

    def __init__(self, contract: PolicyContract, robot: Robot, rows: int = 1) -> None:
        action = contract.action
        place = {name: i for i, name in enumerate(robot.joint_names)}
        for name in contract.joints:
            if name not in place:
                raise PolicyError(
                    f"policy {contract.name}: robot {robot.name} has no joint {name!r}; "
                    f"{alternatives(name, place)}"
                )
        robot_from_policy = np.array([place[name] for name in contract.joints], dtype=np.intp)
        robot_from_action = np.array([place[name] for name in action.joints], dtype=np.intp)
        n, m = robot.num_joints, len(action.joints)
        self.covered = np.zeros(n, bool)
        self.covered[robot_from_action] = True
        offset = robot.default_joint_pos.astype(np.float32)
        offset[robot_from_policy] = contract.default_joint_pos
        offset[robot_from_action] = action.offset
        self.stiffness = robot.joint_stiffness.astype(np.float32)
        self.stiffness[robot_from_policy] = contract.stiffness
        self.damping = robot.joint_damping.astype(np.float32)
        self.damping[robot_from_policy] = contract.damping
        for fact, array in (
            ("default", offset),
            ("stiffness", self.stiffness),
            ("damping", self.damping),
        ):
            unknown = np.flatnonzero(np.isnan(array))
            if unknown.size:
                joint = robot.joint_names[int(unknown[0])]
                raise PolicyError(
                    f"policy {contract.name} does not move joint {joint!r}, and robot {robot.name} "
                    f"has no {fact} to hold it with; add 'joints.{fact}' to {robot.path.name}"
                )
        # One gather covers all joints: held ones take action 0 with scale 0.
        index = np.zeros(n, dtype=np.intp)
        index[robot_from_action] = np.arange(m)
        scale = np.zeros(n, np.float32)
        scale[robot_from_action] = action.scale
        self._index = index[None, :] + np.arange(rows)[:, None] * m
        self._scale, self._offset = scale, offset
        self._feed_clipped = action.feedback == "clipped"
        self._clip = action.clip
        self._clip_all: Floats | None = None
        if action.clip is not None and not self._feed_clipped:
            self._clip_all = np.ascontiguousarray(action.clip[:, index])

    def __call__(self, action: Floats, target: Floats) -> None:
        """Write the targets of this tick.

        Args:
            action: the network's finite output, shape (rows, m); clipped in place where the policy
                was trained with the clipped action fed back.
            target: joint position targets in the robot's order in [rad], shape (rows, n).
        """
        if self._feed_clipped and self._clip is not None:
            np.maximum(action, self._clip[0], out=action)
            np.minimum(action, self._clip[1], out=action)
        action.take(self._index, None, target, "clip")
        if self._clip_all is not None:
            np.maximum(target, self._clip_all[0], out=target)
            np.minimum(target, self._clip_all[1], out=target)
        np.multiply(target, self._scale, target)
        np.add(target, self._offset, target)
