"""ActionMap: from the action of a network to targets of all joints, aligned by name."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import PolicyError, alternatives
from unicon_core.policies.contract import PolicyContract
from unicon_core.policies.controller import ControllerContract
from unicon_core.robots import Robot, joint_index

__all__ = ["ActionMap", "lacking_joints"]

Floats = NDArray[np.float32]


def lacking_joints(contract: ControllerContract, robot: Robot) -> str:
    """Return a message that names the joints of a policy that a robot has not, "" if it has all.

    Args:
        contract: of the policy, or of another controller.
        robot: the robot that is to move.
    """
    lacking = [name for name in contract.joints if name not in robot.joint_names]
    if not lacking:
        return ""
    if len(lacking) == 1:
        name = lacking[0]
        return f"robot {robot.name} has no joint {name!r}; {alternatives(name, robot.joint_names)}"
    return (
        f"robot {robot.name} lacks {len(lacking)} of the {len(contract.joints)} joints needed: "
        f"{', '.join(lacking)}; choose a robot that has them, or a policy made for {robot.name}"
    )


class ActionMap:
    """`joint_pos_target = offset + scale · clip(action)`; other joints are held at default.

    Args:
        contract: the policy.
        robot: the robot that is to move.
        rows: number of robots.

    Attributes:
        stiffness: gain of every joint in the robot's order in [N·m/rad], shape (n,).
        damping: likewise in [N·m·s/rad].

    Raises:
        PolicyError: a joint the robot has not, or a held joint whose pose or gains are unknown.
    """

    def __init__(self, contract: PolicyContract, robot: Robot, rows: int = 1) -> None:
        action = contract.action
        lacking = lacking_joints(contract, robot)
        if lacking:
            raise PolicyError(f"policy {contract.name}: {lacking}")
        robot_from_policy = joint_index(contract.joints, robot.joint_names)
        robot_from_action = joint_index(action.joints, robot.joint_names)
        n, m = robot.num_joints, len(action.joints)
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
                    f"has no {fact} to hold it with; add 'joints.{fact}' to "
                    f"{robot.file_of(joint).name}"
                )
        # One gather covers all joints: held ones take action 0 with scale 0.
        index = np.zeros(n, dtype=np.intp)
        index[robot_from_action] = np.arange(m)
        scale = np.zeros(n, np.float32)
        scale[robot_from_action] = action.scale
        self._index = (index[None, :] + np.arange(rows)[:, None] * m).reshape(-1)
        self._scale, self._offset = np.tile(scale, rows), np.tile(offset, rows)
        self._feed_clipped = action.feedback == "clipped"
        self._clip: Floats | None = None
        if action.clip is not None:
            sides = action.clip if self._feed_clipped else action.clip[:, index]
            self._clip = np.tile(sides, rows)

    def bind(self, action: Floats, target: Floats) -> Callable[[], None]:
        """Return a function that writes the targets of a tick.

        Args:
            action: the network's output, shape (rows, m), to be finite when called; clipped in
                place where the policy was trained with the clipped action fed back.
            target: joint position targets in the robot's order in [rad], shape (rows, n).
        """
        source, out = action.reshape(-1), target.reshape(-1)
        take, index = source.take, self._index
        scale, offset, clip = self._scale, self._offset, self._clip
        multiply, add = np.multiply, np.add

        def plain() -> None:
            take(index, None, out, "clip")
            multiply(out, scale, out)
            add(out, offset, out)

        if clip is None:
            return plain
        low, high = clip
        if self._feed_clipped:

            def clip_action() -> None:
                np.maximum(source, low, out=source)
                np.minimum(source, high, out=source)
                plain()

            return clip_action

        def clip_target() -> None:
            take(index, None, out, "clip")
            np.maximum(out, low, out=out)
            np.minimum(out, high, out=out)
            multiply(out, scale, out)
            add(out, offset, out)

        return clip_target
