"""What the posture blocks share: the command states, the robot's gains, times."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from unicon_base.arrays import Array, Float32
from unicon_base.errors import RobotError, WorkflowError
from unicon_core.flow.block import Bundle, Reads, Writes
from unicon_core.robots import Robot


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

    def entry(self, out: Array) -> None:
        """Write where a movement begins in [rad], shape (..., n).

        A joint that holds a target begins there, so that the torque does not jump; a limp one
        (stiffness 0) begins where it was measured.
        """
        out[...] = np.where(self.joint_stiffness > 0.0, self.joint_pos_target, self.joint_pos)


@dataclass(frozen=True, eq=False)
class Commands(Bundle):
    """The command states as a block reads them, in their order, each of shape (..., n)."""

    joint_pos_target: Reads
    joint_vel_target: Reads
    joint_effort_ff: Reads
    joint_stiffness: Reads
    joint_damping: Reads

    def __iter__(self) -> Iterator[Float32]:
        return iter(vars(self).values())


def robot_gains(
    robot: Robot,
    needed_for: str,
    stiffness_scale: float = 1.0,
    damping_scale: float = 1.0,
    stiffness: float | Mapping[str, float] | None = None,
    damping: float | Mapping[str, float] | None = None,
) -> tuple[Float32, Float32]:
    """Return the stiffness [N·m/rad] and damping [N·m·s/rad] of a robot file, each shape (n,).

    A robot whose vendor closes the position loop has none: 1 then stands for "on".

    Args:
        robot: the robot.
        needed_for: the block, for the message.
        stiffness_scale: factor on the stiffness.
        damping_scale: factor on the damping.
        stiffness: in [N·m/rad], in place of the robot file's and not scaled: of all joints, or of
            groups, joints and patterns.
        damping: in [N·m·s/rad], likewise.

    Raises:
        RobotError: a gain is unknown, or a word means no joint.
    """
    gains = []
    for key, values, scale, given in (
        ("stiffness", robot.joint_stiffness, stiffness_scale, stiffness),
        ("damping", robot.joint_damping, damping_scale, damping),
    ):
        known = np.where(np.isnan(values) & robot.by_position, 1.0, values) * np.float32(scale)
        each = given if isinstance(given, Mapping) else {} if given is None else {"*": given}
        for word, gain in each.items():
            known[robot.group([word])] = gain
        unknown = [name for name, value in zip(robot.joint_names, known) if math.isnan(value)]
        if unknown:
            raise RobotError(
                f"block {needed_for!r}: robot {robot.name} does not say the {key} of joint "
                f"{unknown[0]} ({len(unknown)} joints); give it in {robot.file_of(unknown[0])}"
            )
        gains.append(known.astype(np.float32))
    return gains[0], gains[1]


class Counting:
    """Base of blocks that count their ticks from 1 on since their flow entered them."""

    memory: tuple[str, ...] = ("_tick",)

    def reset(self) -> None:
        """Begin anew with the next tick."""
        self._tick = 0


def ticks_of(seconds: float, period: float) -> int:
    """Return a time as a number of ticks, at least 1."""
    return max(round(seconds / period), 1)


def end_of(duration: float | None, period: float) -> int | None:
    """Return a duration as a number of ticks, at least 1; None for no end."""
    return None if duration is None else ticks_of(duration, period)


def single(view: Array) -> None:
    """Refuse states of several robots, by a view whose robots are its first axis but one.

    Raises:
        WorkflowError: they are.
    """
    if view.ndim > 1:
        raise WorkflowError("it is for one robot; leave num_robots out, or leave it out")
