"""Limits of commands, which clamp or trip: `joint_limits`, `effort_limits`, `rate_limit`.

Each takes `beyond: clamp`, which amends the command, or `beyond: trip`, which raises a fault and
leaves commands alone; behind a limit that clamps the same one may trip with a wider bound.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np

from unicon_base.arrays import Bool, Float32
from unicon_base.errors import Fault, RobotError, WorkflowError
from unicon_base.schema.marks import Within
from unicon_core.bounds import POSITION, SHARE, MaxRate, Scale
from unicon_core.flow.block import Amends, Bundle, Reads, Stage
from unicon_core.robots import Robot
from unicon_core.states.states import Range

ROUNDING = np.float32(1.0001)
"""A target that `rate_limit` has held back is not beyond the same limit."""

Beyond = Literal["clamp", "trip"]
"""What a limit does with a command that is beyond it."""


def limits_of(known: Float32, scale: float | None, usual: float, beyond: Beyond) -> Float32:
    """Return limits of a robot file times the option `scale`, infinite where it says none.

    Args:
        known: of the robot file, shape (n,).
        scale: as given.
        usual: where it is not given.
        beyond: `trip` allows more than the robot file's.

    Raises:
        WorkflowError: it would not limit.
    """
    if scale is not None and scale > SHARE and beyond == "clamp":
        raise WorkflowError(
            f"scale is {scale:g}; write a number above 0 to {SHARE:g}, or beyond: trip"
        )
    return np.nan_to_num(known, nan=np.inf) * np.float32(usual if scale is None else scale)


def first_of(wrong: Bool, robot: Robot) -> tuple[tuple[int, ...], str]:
    """Return index and name of the first joint that is wrong, shape (..., n), for a fault."""
    index = tuple(int(i) for i in np.argwhere(wrong)[0])
    who = f"robot {index[0]}, " if len(index) > 1 else ""
    return index, f"{who}joint {robot.joint_names[index[-1]]}"


def joint_limits(
    joint_pos_target: Amends,
    *,
    robot: Robot,
    margin: Annotated[float, Within(0.0, POSITION, "rad")] = 0.0,
    beyond: Beyond = "clamp",
) -> JointLimits:
    """Hold position targets within the robot's limits; an unknown limit does not bind.

    Args:
        joint_pos_target: in [rad], shape (..., n).
        margin: distance kept from the limits in [rad].
        beyond: `clamp` clips the target, `trip` is a fault.

    Raises:
        WorkflowError: the margin leaves a joint nothing.
    """
    lower, upper = robot.limits()
    lower += np.float32(margin)
    upper -= np.float32(margin)
    if (lower > upper).any():
        joint = robot.joint_names[int(np.argmax(lower > upper))]
        raise WorkflowError(f"margin {margin} rad leaves joint {joint} no range; give less")
    made = JointLimitStop if beyond == "trip" else JointLimits
    return made(joint_pos_target, lower, upper, robot)


class Clamp:
    """Holds targets between bounds, for the ticks of limits.

    Args:
        target: shape (..., n); changed.
        lower, upper: of each joint, in the target's unit, shape (n,).
        robot: names the joints.
    """

    memory = ()

    stage = Stage.SAFETY
    clamps = True

    def __init__(self, target: Float32, lower: Float32, upper: Float32, robot: Robot) -> None:
        self._target = target
        self._lower = lower
        self._upper = upper
        self._robot = robot
        self.ranges = [Range(target, lower, upper)]

    def __call__(self) -> None:
        # Two ufuncs take 0.9 µs for 12 joints, np.clip 1.7: it goes through Python first.
        np.maximum(self._target, self._lower, out=self._target)
        np.minimum(self._target, self._upper, out=self._target)


class Trip(Clamp):
    """Raises a fault instead.

    Attributes:
        said: of target, lower and upper bound, behind the joint.
    """

    clamps = False
    said: str

    def __call__(self) -> None:
        inside = (self._target >= self._lower) & (self._target <= self._upper)
        if not inside.all():
            index, who = first_of(~inside, self._robot)
            joint = index[-1]
            said = self.said.format(self._target[index], self._lower[joint], self._upper[joint])
            raise Fault(f"{who} {said}")


class JointLimits(Clamp):
    """The tick of `joint_limits`."""


class JointLimitStop(Trip, JointLimits):
    """The tick of `joint_limits` with `beyond: trip`."""

    said = "is sent to {:.3f} rad, allowed are {:.3f} to {:.3f}"


def velocity_limits(
    joint_vel_target: Amends, *, robot: Robot, scale: Scale = None, beyond: Beyond = "clamp"
) -> VelocityLimits:
    """Hold velocity targets within the robot's velocity limits; an unknown limit does not bind.

    Args:
        joint_vel_target: in [rad/s], shape (..., n).
        scale: of the robot's limits: 1, and at most that, where it clamps; at most 10 where it
            trips.
        beyond: `clamp` clips the target, `trip` is a fault.
    """
    limit = limits_of(robot.velocity_limit, scale, 1.0, beyond)
    made = VelocityLimitStop if beyond == "trip" else VelocityLimits
    return made(joint_vel_target, -limit, limit, robot)


class VelocityLimits(Clamp):
    """The tick of `velocity_limits`."""

    limits = "joint_vel_target"


class VelocityLimitStop(Trip, VelocityLimits):
    """The tick of `velocity_limits` with `beyond: trip`."""

    said = "is sent a velocity of {0:.2f} rad/s, allowed are {2:.2f}"


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


def effort_limits(
    servo: Servo, *, robot: Robot, scale: Scale = None, beyond: Beyond = "clamp"
) -> EffortLimits:
    """Move targets so that the servo's torque stays within the effort limits.

    tau = kp (q* - q) + kd (qd* - qd) + tau_ff is clipped to ±scale·effort; where it was beyond, q*
    becomes the target that gives the limit (tau_ff where kp is 0). Other joints keep their bits.

    Args:
        scale: of the robot's effort limits [N·m]: 1, and at most that, where it clamps; 2 where it
            trips, since what the motor cannot do does not hurt, and at most 10.
        beyond: `clamp` moves the target, `trip` is a fault.
    """
    trip = beyond == "trip"
    limit = limits_of(robot.effort_limit, scale, 2.0 if trip else 1.0, beyond)
    return (EffortStop if trip else EffortLimits)(servo, limit, robot)


class EffortLimits:
    """The tick of `effort_limits`."""

    memory = ()

    stage = Stage.SAFETY
    clamps = True

    def __init__(self, servo: Servo, limit: Float32, robot: Robot) -> None:
        self._servo = servo
        self._lower = -limit
        self._upper = limit
        self._robot = robot
        target = servo.joint_pos_target
        self._torque, self._rest, self._clipped = (np.zeros_like(target) for _ in range(3))
        self._beyond = np.zeros(target.shape, np.bool_)
        self._stiff, self._limp = self._beyond.copy(), self._beyond.copy()

    def __call__(self) -> None:
        servo = self._servo
        torque = self._torque
        rest = self._rest
        clipped = self._clipped
        beyond = self._beyond
        np.subtract(servo.joint_vel_target, servo.joint_vel, out=rest)
        rest *= servo.joint_damping  # what damping adds
        np.subtract(servo.joint_pos_target, servo.joint_pos, out=torque)
        torque *= servo.joint_stiffness
        torque += rest
        torque += servo.joint_effort_ff
        np.maximum(torque, self._lower, out=clipped)
        np.minimum(clipped, self._upper, out=clipped)
        np.not_equal(torque, clipped, out=beyond)
        if beyond.any():
            self._act()

    def _act(self) -> None:
        servo = self._servo
        rest = self._rest
        clipped = self._clipped
        beyond = self._beyond
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


class EffortStop(EffortLimits):
    """The tick of `effort_limits` with `beyond: trip`."""

    clamps = False

    def _act(self) -> None:
        index, who = first_of(self._beyond, self._robot)
        raise Fault(
            f"{who} is asked for {self._torque[index]:.1f} N·m by its target, allowed are "
            f"{self._upper[index[-1]]:.1f}"
        )


def known_velocity_limits(robot: Robot, remedy: str, hands: float | None = None) -> Float32:
    """Return the velocity limits of a robot file in [rad/s], shape (n,).

    Args:
        robot: whose limits.
        remedy: ends the message.
        hands: the limit where the hands of a body do not say one: what is known of the body holds
            nevertheless. None: they have to.

    Raises:
        RobotError: it does not say them all.
    """
    unknown = np.isnan(robot.velocity_limit)
    fingers = unknown & robot.by_position
    if hands is not None and not fingers.all() and (unknown == fingers).all():
        return np.where(fingers, np.float32(hands), robot.velocity_limit)
    if unknown.any():
        joint = robot.joint_names[int(np.argmax(unknown))]
        raise RobotError(
            f"robot {robot.name} does not say the velocity limit of joint {joint}; {remedy}"
        )
    return robot.velocity_limit


def rates_of(max_rate: MaxRate, robot: Robot, block: str) -> Float32:
    """Return how fast each joint may go by the option `max_rate` of a block, [rad/s], shape (n,).

    Args:
        max_rate: in [rad/s], never above the robot file's limit of a joint, or `robot` for those.
        robot: says them.
        block: for the message.

    Raises:
        RobotError: `robot` is asked for, and its file does not say them.
    """
    if isinstance(max_rate, str):
        return known_velocity_limits(robot, f"give {block} a max_rate in [rad/s]")
    return np.fmin(np.float32(max_rate), robot.velocity_limit)


def rate_limit(
    joint_pos: Reads,
    joint_pos_target: Amends,
    *,
    robot: Robot,
    period: float,
    max_rate: MaxRate = "robot",
    beyond: Beyond = "clamp",
) -> RateLimit:
    """Let position targets move no faster than a speed, beginning at the measured positions.

    Args:
        max_rate: in [rad/s], or `robot` for the robot file's velocity limits.
        beyond: `clamp` holds the target back, `trip` makes a larger step a fault.

    Raises:
        RobotError: the robot file does not say them.
    """
    if isinstance(max_rate, str):
        rate = known_velocity_limits(robot, "give rate_limit a max_rate in [rad/s]")
    else:
        rate = np.full(robot.num_joints, max_rate, np.float32)
    made = RateStop if beyond == "trip" else RateLimit
    return made(joint_pos, joint_pos_target, rate * np.float32(period), robot)


class RateLimit:
    """The tick of `rate_limit`."""

    memory = ("_last", "_fresh")

    stage = Stage.SAFETY
    clamps = True

    def __init__(self, pos: Float32, target: Float32, step: Float32, robot: Robot) -> None:
        self._pos = pos
        self._target = target
        self._step = step
        self._robot = robot
        self._last = np.zeros_like(target)
        self._bound = np.zeros_like(target)
        self._fresh = True

    def __call__(self) -> None:
        if self._fresh:
            self._last[...] = self._pos
            self._fresh = False
        self._act()
        self._last[...] = self._target

    def _act(self) -> None:
        np.subtract(self._last, self._step, out=self._bound)
        np.maximum(self._target, self._bound, out=self._target)
        np.add(self._last, self._step, out=self._bound)
        np.minimum(self._target, self._bound, out=self._target)

    def reset(self) -> None:
        """Begin anew at the measured positions."""
        self._fresh = True


class RateStop(RateLimit):
    """The tick of `rate_limit` with `beyond: trip`."""

    clamps = False

    def _act(self) -> None:
        np.subtract(self._target, self._last, out=self._bound)
        np.abs(self._bound, out=self._bound)
        inside = self._bound <= self._step * ROUNDING
        if not inside.all():
            index, who = first_of(~inside, self._robot)
            raise Fault(
                f"{who} is sent {self._bound[index]:.3f} rad on in one tick, allowed are "
                f"{self._step[index[-1]]:.3f}"
            )
