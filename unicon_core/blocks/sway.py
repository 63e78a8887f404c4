"""Block `sway`: a standing robot leans as the velocity command says, feet where they are."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from unicon_core.blocks.joint_command import JointCommand, robot_gains, ticks_of
from unicon_core.errors import WorkflowError
from unicon_core.flow.block import Reads
from unicon_core.robots import Robot
from unicon_core.robots.poses import joints_like, named_pose

OTHERS = "give gains of its joints, or run h1_stand, which names none"
"""What helps a robot that the workflow was not written for."""


def sway(
    command: JointCommand,
    velocity_command: Reads,
    *,
    robot: Robot,
    period: float,
    gains: Mapping[str, Sequence[float]],
    amplitude: Sequence[float] = (0.0, 0.0, 0.0),
    frequency: float = 0.5,
    time_constant: float = 0.3,
    around: str | Mapping[str, float] = "stand",
    duration: float | None = None,
) -> Sway:
    """Move the position targets around a pose: target = pose + K (command + own oscillation).

    Args:
        gains: joint names and patterns to their row of K: radians for each m/s of vx, m/s of vy and
            rad/s of wz; rows of patterns that meet on a joint add up.
        amplitude: of the block's own sine command, vx, vy in [m/s] and wz in [rad/s].
        frequency: of that sine in [Hz].
        time_constant: of the first-order filter on the targets in [s].
        around: the pose, as for `pose`.
        duration: in [s]; None never ends.

    The targets stay within the robot's joint limits.
    """
    matrix = np.zeros((robot.num_joints, 3), np.float32)
    for pattern, row in gains.items():
        if not isinstance(row, Sequence) or len(row) != 3:
            raise WorkflowError(f"gains of {pattern!r} are {row!r}; give [per vx, per vy, per wz]")
        matrix[joints_like(pattern, robot, OTHERS)] += np.asarray(row, np.float32)
    if len(amplitude) != 3:
        raise WorkflowError(f"amplitude is {list(amplitude)}; give [vx, vy, wz]")
    centre, said = named_pose(around, robot, "block 'sway'")
    centre = np.where(said > 0.0, centre, np.nan_to_num(robot.default_joint_pos))
    return Sway(
        command,
        velocity_command,
        robot,
        period,
        matrix,
        centre,
        np.asarray(amplitude, np.float32),
        frequency,
        time_constant,
        ticks_of(duration, period, "duration"),
    )


class Sway:
    """The tick of `sway`."""

    memory = ("_filtered", "_tick")

    def __init__(
        self,
        command: JointCommand,
        velocity_command: NDArray[np.float32],
        robot: Robot,
        period: float,
        matrix: NDArray[np.float32],
        centre: NDArray[np.float32],
        amplitude: NDArray[np.float32],
        frequency: float,
        time_constant: float,
        ticks: int | None,
    ) -> None:
        self._command, self._velocity = command, velocity_command
        self._centre = centre
        self._amplitude, self._turn = amplitude, 2.0 * math.pi * frequency * period
        self._share = 1.0 if time_constant <= 0.0 else -math.expm1(-period / time_constant)
        self._lower = np.nan_to_num(robot.lower, nan=-np.inf)
        self._upper = np.nan_to_num(robot.upper, nan=np.inf)
        self.gains = robot_gains(robot, "sway")
        self._ticks, self._tick = ticks, 0
        self.endless = ticks is None
        self._filtered, self._wanted, self._moved = (
            np.zeros_like(command.joint_pos_target) for _ in range(3)
        )
        self._twist = np.zeros_like(velocity_command)
        rows = np.ascontiguousarray(matrix.T)
        self._parts = [(self._twist[..., i : i + 1], row) for i, row in enumerate(rows)]

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
