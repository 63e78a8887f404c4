"""Safety blocks that amend commands: `joint_limits`, `effort_limits`, `rate_limit`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from unicon_core.bounds import POSITION, SHARE, VELOCITY, within
from unicon_core.errors import RobotError, WorkflowError
from unicon_core.flow.block import Amends, Bundle, Reads
from unicon_core.flow.stage import Stage
from unicon_core.robots import Robot

__all__ = [
    "EffortLimits",
    "JointLimits",
    "RateLimit",
    "Servo",
    "effort_limits",
    "joint_limits",
    "rate_limit",
    "velocity_limits",
]

Float = NDArray[np.float32]


def joint_limits(joint_pos_target: Amends, *, robot: Robot, margin: float = 0.0) -> JointLimits:
    """Clip position targets to the robot's limits; an unknown limit does not bind.

    Args:
        joint_pos_target: in [rad], shape (..., n).
        margin: distance kept from the limits in [rad].

    Raises:
        WorkflowError: the margin is negative or leaves a joint nothing.
    """
    margin = within(margin, "margin", "rad", POSITION, above=False, what="joint_limits")
    lower = np.nan_to_num(robot.lower, nan=-np.inf) + np.float32(margin)
    upper = np.nan_to_num(robot.upper, nan=np.inf) - np.float32(margin)
    if (lower > upper).any():
        joint = robot.joint_names[int(np.argmax(lower > upper))]
        raise WorkflowError(f"margin {margin} rad leaves joint {joint} no range; give less")
    return JointLimits(joint_pos_target, lower, upper)


class JointLimits:
    """The tick of `joint_limits`."""

    stage = Stage.SAFETY
    clamps = True

    def __init__(self, target: Float, lower: Float, upper: Float) -> None:
        self._target, self._lower, self._upper = target, lower, upper

    def __call__(self) -> None:
        # Two ufuncs take 0.9 µs for 12 joints, np.clip 1.7: it goes through Python first.
        np.maximum(self._target, self._lower, out=self._target)
        np.minimum(self._target, self._upper, out=self._target)


@dataclass(frozen=True, eq=False)
class Servo(Bundle):
    """What a servo makes a torque of, each of shape (..., n); the targets may be changed."""

    joint_pos: Reads
    joint_vel: Reads
    joint_vel_target: Reads
    joint_stiffness: Reads
    joint_damping: Reads
    joint_pos_target: Amends
    joint_effort_ff: Amends


def effort_limits(servo: Servo, *, robot: Robot, scale: float = 1.0) -> EffortLimits:
    """Move targets so that the servo's torque stays within the effort limits.

    tau = kp (q* - q) + kd (qd* - qd) + tau_ff is clipped to ±scale·effort; where it was beyond, q*
    becomes the target that gives the limit (tau_ff where kp is 0). Other joints keep their bits.

    Args:
        scale: share of the robot's effort limits [N·m] that may be used, up to 1.
    """
    scale = within(scale, "scale", "", SHARE, what="effort_limits")
    limit = np.nan_to_num(robot.effort_limit, nan=np.inf) * np.float32(scale)
    return EffortLimits(servo, limit)


class EffortLimits:
    """The tick of `effort_limits`."""

    stage = Stage.SAFETY
    clamps = True

    def __init__(self, servo: Servo, limit: Float) -> None:
        self._servo, self._lower, self._upper = servo, -limit, limit
        target = servo.joint_pos_target
        self._torque, self._rest, self._clipped = (np.zeros_like(target) for _ in range(3))
        self._beyond = np.zeros(target.shape, np.bool_)
        self._stiff, self._limp = self._beyond.copy(), self._beyond.copy()

    def __call__(self) -> None:
        servo = self._servo
        torque, rest, clipped, beyond = self._torque, self._rest, self._clipped, self._beyond
        np.subtract(servo.joint_vel_target, servo.joint_vel, out=rest)
        rest *= servo.joint_damping  # what damping adds
        np.subtract(servo.joint_pos_target, servo.joint_pos, out=torque)
        torque *= servo.joint_stiffness
        torque += rest
        torque += servo.joint_effort_ff
        np.maximum(torque, self._lower, out=clipped)
        np.minimum(clipped, self._upper, out=clipped)
        np.not_equal(torque, clipped, out=beyond)
        if not beyond.any():
            return
        np.greater(servo.joint_stiffness, 0.0, out=self._stiff)
        np.logical_not(self._stiff, out=self._limp)
        self._stiff &= beyond
        self._limp &= beyond
        clipped -= rest
        np.copyto(servo.joint_effort_ff, clipped, where=self._limp)
        clipped -= servo.joint_effort_ff
        np.divide(clipped, servo.joint_stiffness, out=clipped, where=self._stiff)
        clipped += servo.joint_pos
        np.copyto(servo.joint_pos_target, clipped, where=self._stiff)


def velocity_limits(robot: Robot, remedy: str) -> Float:
    """Return the velocity limits of a robot file in [rad/s], shape (n,).

    Raises:
        RobotError: it does not say them all; the message ends with the remedy.
    """
    unknown = np.isnan(robot.velocity_limit)
    if unknown.any():
        joint = robot.joint_names[int(np.argmax(unknown))]
        raise RobotError(
            f"robot {robot.name} does not say the velocity limit of joint {joint}; {remedy}"
        )
    return robot.velocity_limit


def rate_limit(
    joint_pos: Reads,
    joint_pos_target: Amends,
    *,
    robot: Robot,
    period: float,
    max_rate: float | Literal["robot"] = "robot",
) -> RateLimit:
    """Let position targets move no faster than a speed, beginning at the measured positions.

    Args:
        max_rate: in [rad/s], or `robot` for the robot file's velocity limits.

    Raises:
        RobotError: the robot file does not say them.
    """
    if max_rate == "robot":
        rate = velocity_limits(robot, "give rate_limit a max_rate in [rad/s]")
    elif isinstance(max_rate, str):
        raise WorkflowError(f"max_rate is {max_rate!r}; give [rad/s] above 0, or robot")
    else:
        most = within(max_rate, "max_rate", "rad/s", VELOCITY, what="rate_limit")
        rate = np.full(robot.num_joints, most, np.float32)
    return RateLimit(joint_pos, joint_pos_target, rate * np.float32(period))


class RateLimit:
    """The tick of `rate_limit`."""

    stage = Stage.SAFETY
    clamps = True

    def __init__(self, pos: Float, target: Float, step: Float) -> None:
        self._pos, self._target, self._step = pos, target, step
        self._last, self._bound = np.zeros_like(target), np.zeros_like(target)
        self._fresh = True

    def __call__(self) -> None:
        if self._fresh:
            self._last[...] = self._pos
            self._fresh = False
        np.subtract(self._last, self._step, out=self._bound)
        np.maximum(self._target, self._bound, out=self._target)
        np.add(self._last, self._step, out=self._bound)
        np.minimum(self._target, self._bound, out=self._target)
        self._last[...] = self._target

    def reset(self) -> None:
        """Begin anew at the measured positions."""
        self._fresh = True
