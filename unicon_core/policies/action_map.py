"""ActionMap: from the action of a network to targets of all joints, aligned by name."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

import numpy as np

from unicon_base import PolicyError, RobotError, alternatives
from unicon_base.arrays import Float32
from unicon_core.policies.contract import PolicyContract
from unicon_core.policies.controller import ControllerContract
from unicon_core.policies.phase import Filter, make_filter
from unicon_core.robots import Robot, joint_index


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
    lacks = (
        f"robot {robot.name} lacks {len(lacking)} of the {len(contract.joints)} joints needed: "
        f"{', '.join(lacking)}; "
    )
    with suppress(RobotError):
        meant = joint_index(lacking, robot.joint_names, loose=True)
        names = ", ".join(robot.joint_names[i] for i in meant)
        how = "import it (unicon policies import) and name them in its joints"
        return f"{lacks}did you mean {names}? {how}"
    return f"{lacks}choose a robot that has them, or a policy made for {robot.name}"


class ActionMap:
    """`target = offset + scale · filter(clip(action))`; other joints are held at default.

    Args:
        contract: the policy.
        robot: the robot that is to move.
        rows: number of robots.

    Attributes:
        stiffness: gain of every joint in the robot's order in [N·m/rad], shape (n,).
        damping: likewise in [N·m·s/rad].
        positions_only: all that it gives are positions.
        filter: of the clipped action, shape (rows, m), or None.

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
        by_position = action.of_kind("position")
        self.positions_only = bool(by_position.all())
        offset[robot_from_action[by_position]] = action.offset[by_position]
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
        index = np.zeros(n, np.intp)
        index[robot_from_action] = np.arange(m)
        scale = np.zeros(n, np.float32)
        scale[robot_from_action[by_position]] = action.scale[by_position]
        self._of_action = robot_from_action
        self._index = (index[None, :] + np.arange(rows)[:, None] * m).reshape(-1)
        self._scale, self._offset = np.tile(scale, rows), np.tile(offset, rows)
        self._feed_clipped = action.feedback == "clipped"
        self.filter: Filter | None = None
        if action.filter is not None:
            self.filter = make_filter(action.filter, (rows, m), contract.period)
        self._spec, self._rows = action, rows
        closed = dict(zip(robot.joint_names, robot.by_position))
        for name, kind in zip(action.joints, action.kinds):
            if kind != "position" and closed[name]:
                raise PolicyError(
                    f"policy {contract.name} gives joint {name!r} a {kind}, and robot {robot.name} "
                    "takes positions alone; choose a policy that gives positions"
                )
        # Of velocities and torques as of positions: figures of all joints, 0 where they are none.
        self._rates = []
        for kind in ("velocity", "torque"):
            at, figures = action.of_kind(kind), np.zeros((2, n), np.float32)
            figures[:, robot_from_action[at]] = action.scale[at], action.offset[at]
            self._rates.append(np.tile(figures, rows))
        limp = np.zeros(n, np.bool_)
        limp[robot_from_action[~by_position]] = True
        self._limp = limp & (self.stiffness == 0.0)
        self._clip: Float32 | None = None
        if action.clip is not None:
            sides = action.clip if self._feed_clipped else action.clip[:, index]
            self._clip = np.tile(sides, rows)

    def inverse(self, target: Float32) -> Float32:
        """Return the action that gives these targets of positions, as clipped and filtered.

        Args:
            target: joint position targets of one robot in its order in [rad], shape (n,).

        Returns:
            Action of shape (m,); 0 where the scale is.
        """
        offset, scale = self._spec.offset, self._spec.scale
        action = np.zeros_like(scale)
        np.divide(target[self._of_action] - offset, scale, out=action, where=scale != 0.0)
        return action

    def bind_all(
        self,
        action: Float32,
        position: Float32,
        velocity: Float32,
        torque: Float32,
        measured: Float32,
    ) -> Callable[[], None]:
        """Return a function that writes the targets of a tick of any kind.

        A joint without stiffness that is given a velocity or torque has its measured position as
        target: whatever gives it stiffness later, such as a blend, holds it where it is.

        Args:
            action: the network's output, shape (rows, m), to be finite when called; replaced by
                what was clipped or filtered of it where that is fed back.
            position: targets in the robot's order in [rad], shape (rows, n).
            velocity: likewise in [rad/s].
            torque: likewise in [N·m].
            measured: joint positions in [rad], shape (rows, n).
        """
        spec, index, smooth = self._spec, self._index, self.filter
        work, limp = np.zeros_like(action), np.tile(self._limp, (self._rows, 1))
        source = work.reshape(-1)
        rates = [
            (out.reshape(-1), *figures) for out, figures in zip((velocity, torque), self._rates)
        ]
        places = position.reshape(-1), self._scale, self._offset
        outs = [places] if self.positions_only else [places, *rates]

        def all_kinds() -> None:
            work[...] = action
            if spec.clip is not None:
                np.maximum(work, spec.clip[0], out=work)
                np.minimum(work, spec.clip[1], out=work)
            if spec.feedback == "clipped":
                action[...] = work
            if smooth is not None:
                smooth(work)
            if spec.feedback == "filtered":
                action[...] = work
            for out, scale, offset in outs:
                source.take(index, None, out, "clip")
                np.multiply(out, scale, out=out)
                np.add(out, offset, out=out)
            np.copyto(position, measured, where=limp)

        return all_kinds

    def bind(self, action: Float32, target: Float32) -> Callable[[], None]:
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
        maximum, minimum = np.maximum, np.minimum

        def plain() -> None:
            take(index, None, out, "clip")
            multiply(out, scale, out)
            add(out, offset, out)

        if clip is None:
            return plain
        low, high = clip
        fed = source if self._feed_clipped else out

        def clipped() -> None:
            if fed is out:
                take(index, None, out, "clip")
            maximum(fed, low, out=fed)
            minimum(fed, high, out=fed)
            if fed is source:
                take(index, None, out, "clip")
            multiply(out, scale, out)
            add(out, offset, out)

        return clipped
