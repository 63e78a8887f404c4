"""Block `sway`: a standing robot leans as the velocity command says, feet where they are."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated

import numpy as np

from unicon_core.blocks.joint_command import JointCommand, end_of, robot_gains
from unicon_core.bounds import Seconds
from unicon_core.flow.block import Reads
from unicon_core.robots import Robot
from unicon_core.robots.poses import joints_like, named_pose
from unicon_core.schema.marks import Write

OTHERS = "give gains of its joints, or run h1_stand, which names none"
"""What helps a robot that the workflow was not written for."""


class Sway:
    """Move the position targets around a pose: target = pose + K (command + own oscillation).

    The targets stay within the robot's joint limits.

    Args:
        gains: joint names and patterns to their row of K: radians for each m/s of vx, m/s of vy and
            rad/s of wz; rows of patterns that meet on a joint add up.
        amplitude: of the block's own sine command, vx, vy in [m/s] and wz in [rad/s].
        frequency: of that sine in [Hz].
        time_constant: of the first-order filter on the targets in [s].
        around: the pose, as for `pose`.
        duration: in [s]; None never ends.
    """

    memory = ("_filtered", "_tick")

    def __init__(
        self,
        command: JointCommand,
        velocity_command: Reads,
        *,
        robot: Robot,
        period: float,
        gains: Mapping[
            str, Annotated[tuple[float, float, float], Write("[per vx, per vy, per wz]")]
        ],
        amplitude: Annotated[tuple[float, float, float], Write("[vx, vy, wz]")] = (0.0, 0.0, 0.0),
        frequency: float = 0.5,
        time_constant: float = 0.3,
        around: str | Mapping[str, float] = "stand",
        duration: Seconds | None = None,
    ) -> None:
        matrix = np.zeros((3, robot.num_joints), np.float32)
        for pattern, row in gains.items():
            matrix[:, joints_like(pattern, robot, OTHERS)] += np.asarray(row, np.float32)[:, None]
        centre, said = named_pose(around, robot, "block 'sway'")
        self._centre = np.where(said > 0.0, centre, np.nan_to_num(robot.default_joint_pos))
        self._command, self._velocity = command, velocity_command
        self._amplitude = np.asarray(amplitude, np.float32)
        self._turn = 2.0 * math.pi * frequency * period
        self._share = 1.0 if time_constant <= 0.0 else -math.expm1(-period / time_constant)
        self._lower = np.nan_to_num(robot.lower, nan=-np.inf)
        self._upper = np.nan_to_num(robot.upper, nan=np.inf)
        self.gains = robot_gains(robot, "sway")
        self._ticks, self._tick = end_of(duration, period), 0
        self.endless = duration is None
        self._filtered, self._wanted, self._moved = (
            np.zeros_like(command.joint_pos_target) for _ in range(3)
        )
        self._twist = np.zeros_like(velocity_command)
        self._parts = [(self._twist[..., i : i + 1], row) for i, row in enumerate(matrix)]

    def __call__(self) -> bool:
        command, wanted, filtered = self._command, self._wanted, self._filtered
        if self._tick == 0:
            command.entry(filtered)
        self._tick += 1
        np.multiply(self._amplitude, math.sin(self._turn * self._tick), out=self._twist)
        self._twist += self._velocity
        # No matrix product: BLAS rounds a batch otherwise than a single robot.
        wanted[...] = self._centre
        for part, row in self._parts:
            np.multiply(part, row, out=self._moved)
            wanted += self._moved
        np.maximum(wanted, self._lower, out=wanted)
        np.minimum(wanted, self._upper, out=wanted)
        wanted -= filtered
        wanted *= self._share
        filtered += wanted
        command.joint_pos_target[...] = filtered
        command.joint_vel_target[...] = 0.0
        command.joint_effort_ff[...] = 0.0
        command.joint_stiffness[...], command.joint_damping[...] = self.gains
        return self._ticks is not None and self._tick >= self._ticks

    def reset(self) -> None:
        """Begin anew from wherever the joints are at the next tick."""
        self._tick = 0
