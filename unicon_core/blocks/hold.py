"""Blocks `hold` and `damp`: stay where you are, and go limp with damping."""

from __future__ import annotations

import numpy as np

from unicon_core.blocks.joint_command import JointCommand, end_of, robot_gains
from unicon_core.bounds import Damping, Seconds
from unicon_core.robots import Robot


class Hold:
    """Keep the position targets of the moment of entry; limp joints keep their measured position.

    Args:
        duration: in [s]; None never ends.
        keep_gains: leave stiffness and damping as the block before set them (a policy's), instead
            of the robot file's.
    """

    memory = ("_held", "_tick")

    def __init__(
        self,
        command: JointCommand,
        *,
        robot: Robot,
        period: float,
        duration: Seconds | None = None,
        keep_gains: bool = False,
    ) -> None:
        self._command, self._ticks = command, end_of(duration, period)
        self.endless = duration is None
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


class Damp:
    """Let go: stiffness 0, damping against every motion, targets at the measured positions.

    Args:
        duration: in [s]; None never ends.
        damping: of every joint in [N·m·s/rad]; None for the robot file's.
    """

    memory = ("_tick",)

    def __init__(
        self,
        command: JointCommand,
        *,
        robot: Robot,
        period: float,
        duration: Seconds | None = None,
        damping: Damping | None = None,
    ) -> None:
        self._command, self._ticks = command, end_of(duration, period)
        self._gain = (
            robot_gains(robot, "damp")[1]
            if damping is None
            else np.full(robot.num_joints, damping, np.float32)
        )
        self.endless = duration is None
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
