"""Block `velocity_limits`: holds velocity targets, such as those of wheels, within the robot's."""

from __future__ import annotations

from unicon_core.blocks.safety.limits import Beyond, Clamp, Trip, limits_of
from unicon_core.bounds import Scale
from unicon_core.flow.block import Amends
from unicon_core.robots import Robot


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
