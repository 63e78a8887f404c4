"""Block `velocity_limits`: holds velocity targets, such as those of wheels, within the robot's."""

from __future__ import annotations

import numpy as np

from unicon_core.blocks.safety.limits import Beyond, Float, first_of, trips
from unicon_core.bounds import SHARE, TRIP_SHARE, within
from unicon_core.errors import Fault
from unicon_core.flow.block import Amends
from unicon_core.flow.stage import Stage
from unicon_core.robots import Robot
from unicon_core.states.screen import Range


def velocity_limits(
    joint_vel_target: Amends,
    *,
    robot: Robot,
    scale: float | None = None,
    beyond: Beyond = "clamp",
) -> VelocityLimits:
    """Hold velocity targets within the robot's velocity limits; an unknown limit does not bind.

    Args:
        joint_vel_target: in [rad/s], shape (..., n).
        scale: of the robot's limits: 1, and at most that, where it clamps; at most 10 where it
            trips.
        beyond: `clamp` clips the target, `trip` is a fault.
    """
    trip = trips(beyond)
    most = TRIP_SHARE if trip else SHARE
    scale = within(1.0 if scale is None else scale, "scale", "", most, what="velocity_limits")
    limit = np.nan_to_num(robot.velocity_limit, nan=np.inf) * np.float32(scale)
    return (VelocityLimitStop if trip else VelocityLimits)(joint_vel_target, limit, robot)


class VelocityLimits:
    """The tick of `velocity_limits`."""

    memory = ()

    stage = Stage.SAFETY
    clamps = True
    limits = "joint_vel_target"

    def __init__(self, target: Float, limit: Float, robot: Robot) -> None:
        self._target, self._lower, self._upper, self._robot = target, -limit, limit, robot
        self.ranges = [Range(target, -limit, limit)]

    def __call__(self) -> None:
        np.maximum(self._target, self._lower, out=self._target)
        np.minimum(self._target, self._upper, out=self._target)


class VelocityLimitStop(VelocityLimits):
    """The tick of `velocity_limits` with `beyond: trip`."""

    clamps = False

    def __call__(self) -> None:
        inside = (self._target >= self._lower) & (self._target <= self._upper)
        if not inside.all():
            index, who = first_of(~inside, self._robot)
            raise Fault(
                f"{who} is sent a velocity of {self._target[index]:.2f} rad/s, allowed are "
                f"{self._upper[index[-1]]:.2f}"
            )
