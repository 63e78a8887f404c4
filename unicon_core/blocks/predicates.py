"""Predicates: `elapsed`, `tilted`, `settled`, for `until:` and `when:` and as waiting blocks."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, cast

import numpy as np

from unicon_base.arrays import Float32
from unicon_base.schema.marks import positive
from unicon_core.blocks.joint_command import Counting, ticks_of
from unicon_core.bounds import Seconds
from unicon_core.flow.block import Reads


class Elapsed(Counting):
    """Hold from the tick on in which a time has passed since entry.

    Args:
        seconds: counted in ticks, so that it means the same at any speed of the run.
    """

    def __init__(self, *, period: float, seconds: Seconds) -> None:
        self._ticks = ticks_of(seconds, period)
        self._tick = 0

    def __call__(self) -> bool:
        self._tick += 1
        return self._tick >= self._ticks


def tilted(
    projected_gravity: Reads, *, angle: Annotated[float, positive(math.pi, "rad")] = 1.0
) -> Callable[[], bool]:
    """Hold while the base leans by more than an angle; of a batch, any of them.

    Args:
        projected_gravity: unit vector of gravity in the base frame, shape (..., 3).
        angle: between the base's z axis and the vertical in [rad].
    """
    bound = -math.cos(angle)
    most = largest(projected_gravity[..., 2])

    def is_tilted() -> bool:
        return not most() <= bound  # true for NaN: a lost IMU is not an upright robot

    return is_tilted


def largest(values: Float32) -> Callable[[], float]:
    """Return what reads the largest element; of a scalar its value, which is 8x faster."""
    return cast("Callable[[], float]", values.max if values.ndim else values.item)


class Commanded:
    """Hold while somebody commands a motion, and a while longer.

    Args:
        velocity_command: vx, vy in [m/s], wz in [rad/s], shape (..., 3).
        least: a magnitude below this is not a command, in [m/s] or [rad/s].
        hold: for how long it holds after the last command in [s].
    """

    memory = ("_left",)

    def __init__(
        self, velocity_command: Reads, *, period: float, least: float = 0.05, hold: Seconds = 1.0
    ) -> None:
        self._command = velocity_command.reshape(-1)
        self._least = least
        self._ticks = ticks_of(hold, period)
        self._left = 0

    def __call__(self) -> bool:
        if max(map(abs, self._command.tolist())) > self._least:
            self._left = self._ticks
            return True
        self._left = max(self._left - 1, 0)
        return self._left > 0

    def reset(self) -> None:
        """Forget the last command."""
        self._left = 0


class Settled:
    """Hold once every joint has been slow for some time.

    Args:
        joint_vel: in [rad/s], shape (..., n).
        velocity: what counts as slow in [rad/s].
        duration: for how long in [s].
    """

    memory = ("_slow",)

    def __init__(
        self, joint_vel: Reads, *, period: float, velocity: float = 0.1, duration: Seconds = 0.5
    ) -> None:
        self._vel = joint_vel
        self._bound = velocity
        self._ticks = ticks_of(duration, period)
        self._speed = np.zeros_like(joint_vel)
        self._slow = 0

    def __call__(self) -> bool:
        np.abs(self._vel, out=self._speed)
        self._slow = self._slow + 1 if self._speed.max() <= self._bound else 0
        return self._slow >= self._ticks

    def reset(self) -> None:
        """Wait anew."""
        self._slow = 0
