"""Blocks `hold` and `damp`: stay where you are, and go limp with damping."""

from __future__ import annotations

import numpy as np

from unicon_core.blocks.joint_command import JointCommand, robot_gains, ticks_of
from unicon_core.bounds import DAMPING, within
from unicon_core.robots import Robot


def hold(
    command: JointCommand,
    *,
    robot: Robot,
    period: float,
    duration: float | None = None,
    keep_gains: bool = False,
) -> Hold:
    """Keep the position targets of the moment of entry; limp joints keep their measured position.

    Args:
        duration: in [s]; None never ends.
        keep_gains: leave stiffness and damping as the block before set them (a policy's), instead
            of the robot file's.
    """
    return Hold(command, robot, ticks_of(duration, period, "duration"), keep_gains)


class Hold:
    """The tick of `hold`."""

    memory = ("_held", "_tick")

    def __init__(
        self, command: JointCommand, robot: Robot, ticks: int | None, keep_gains: bool
    ) -> None:
        self._command, self._ticks = command, ticks
        self.endless = ticks is None
        self.gains = None if keep_gains else robot_gains(robot, "hold")
        self._held = np.zeros_like(command.joint_pos_target)
        self._tick = 0

    def __call__(self) -> bool:
        command = self._command
        if self._tick == 0:
            command.entry(self._held)
        self._tick += 1
        command.joint_pos_target[...] = self._held
        command.joint_vel_target[...] = 0.0
        command.joint_effort_ff[...] = 0.0
        if self.gains is not None:
            command.joint_stiffness[...], command.joint_damping[...] = self.gains
        return self._ticks is not None and self._tick >= self._ticks

    def reset(self) -> None:
        """Hold whatever is the target at the next tick."""
        self._tick = 0


def damp(
    command: JointCommand,
    *,
    robot: Robot,
    period: float,
    duration: float | None = None,
    damping: float | None = None,
) -> Damp:
    """Let go: stiffness 0, damping against every motion, targets at the measured positions.

    Args:
        duration: in [s]; None never ends.
        damping: of every joint in [N·m·s/rad]; None for the robot file's.
    """
    if damping is None:
        gain = robot_gains(robot, "damp")[1]
    else:
        damping = within(damping, "damping", "N·m·s/rad", DAMPING, above=False)
        gain = np.full(robot.num_joints, damping, np.float32)
    return Damp(command, gain, ticks_of(duration, period, "duration"))


class Damp:
    """The tick of `damp`."""

    memory = ("_tick",)

    def __init__(
        self, command: JointCommand, gain: np.typing.NDArray[np.float32], ticks: int | None
    ) -> None:
        self._command, self._gain, self._ticks = command, gain, ticks
        self.endless = ticks is None
        self._tick = 0

    def __call__(self) -> bool:
        command = self._command
        command.joint_pos_target[...] = command.joint_pos
        command.joint_vel_target[...] = 0.0
        command.joint_effort_ff[...] = 0.0
        command.joint_stiffness[...] = 0.0
        command.joint_damping[...] = self._gain
        self._tick += 1
        return self._ticks is not None and self._tick >= self._ticks

    def reset(self) -> None:
        """Count the duration anew."""
        self._tick = 0
