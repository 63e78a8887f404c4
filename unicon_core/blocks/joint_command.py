"""What the posture blocks share: the command states, the robot's gains, times."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.bounds import DAMPING, GAIN_SCALES, STIFFNESS, within
from unicon_core.errors import RobotError, WorkflowError
from unicon_core.flow.block import Bundle, Reads, Writes
from unicon_core.robots import Robot

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


Gain = float | Mapping[str, float]
"""A gain for all joints, or groups, joints and patterns to gains."""


def robot_gains(
    robot: Robot,
    needed_for: str,
    stiffness_scale: float = 1.0,
    damping_scale: float = 1.0,
    stiffness: Gain | None = None,
    damping: Gain | None = None,
) -> tuple[Float, Float]:
    """Return the stiffness [N·m/rad] and damping [N·m·s/rad] of a robot file, each shape (n,).

    A robot whose vendor closes the position loop has none: 1 then stands for "on".

    Args:
        robot: the robot.
        needed_for: the block, for the message.
        stiffness_scale: factor on the stiffness.
        damping_scale: factor on the damping.
        stiffness: in [N·m/rad], in place of the robot file's and not scaled.
        damping: in [N·m·s/rad], likewise.

    Raises:
        RobotError: a gain is unknown, or a word means no joint.
        WorkflowError: a factor or gain is not plausible.
    """
    gains = []
    for key, values, scale, given, unit, most in (
        ("stiffness", robot.joint_stiffness, stiffness_scale, stiffness, "N·m/rad", STIFFNESS),
        ("damping", robot.joint_damping, damping_scale, damping, "N·m·s/rad", DAMPING),
    ):
        option = f"{key}_scale"
        scale = within(scale, option, "", GAIN_SCALES[option], above=False)
        known = np.where(np.isnan(values) & robot.by_position, 1.0, values) * np.float32(scale)
        each = given if isinstance(given, Mapping) else {} if given is None else {"*": given}
        for word, gain in each.items():
            of = f"{key} of {word!r}" if isinstance(given, Mapping) else key
            known[robot.group([word])] = within(gain, of, unit, most, above=False)
        unknown = [name for name, value in zip(robot.joint_names, known) if math.isnan(value)]
        if unknown:
            raise RobotError(
                f"block {needed_for!r}: robot {robot.name} does not say the {key} of joint "
                f"{unknown[0]} ({len(unknown)} joints); give it in {robot.file_of(unknown[0])}"
            )
        gains.append(known.astype(np.float32))
    return gains[0], gains[1]


def ticks_of(seconds: float | None, period: float, option: str) -> int | None:
    """Return a time as a number of ticks, at least 1; None for no end.

    Raises:
        WorkflowError: it is not a time.
    """
    if seconds is None:
        return None
    number = isinstance(seconds, (int, float)) and not isinstance(seconds, bool)
    if not number or not 0.0 <= seconds <= LONGEST_S:
        raise WorkflowError(
            f"{option} is {seconds!r}; give a time from 0 to {LONGEST_S:g} in [s], or leave it out"
        )
    return max(round(seconds / period), 1)
