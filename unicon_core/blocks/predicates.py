"""Predicates: `elapsed`, `tilted`, `settled`, for `until:` and `when:` and as waiting blocks."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import cast

import numpy as np
from numpy.typing import NDArray

from unicon_core.blocks.joint_command import ticks_of
from unicon_core.errors import WorkflowError
from unicon_core.flow.block import Reads


def elapsed(*, period: float, seconds: float) -> Elapsed:
    """Hold from the tick on in which a time has passed since entry.

    Args:
        seconds: counted in ticks, so that it means the same at any speed of the run.
    """
    return Elapsed(ticks_of(seconds, period, "seconds") or 1)


class Elapsed:
    """The tick of `elapsed`."""

    memory = ("_tick",)

    def __init__(self, ticks: int) -> None:
        self._ticks, self._tick = ticks, 0

    def __call__(self) -> bool:
        self._tick += 1
        return self._tick >= self._ticks

    def reset(self) -> None:
        """Count anew."""
        self._tick = 0


def tilted(projected_gravity: Reads, *, angle: float = 1.0) -> Callable[[], bool]:
    """Hold while the base leans by more than an angle; of a batch, any of them.

    Args:
        projected_gravity: unit vector of gravity in the base frame, shape (..., 3).
        angle: between the base's z axis and the vertical in [rad].
    """
    if not 0.0 < angle <= math.pi:
        raise WorkflowError(f"angle is {angle}; give radians above 0, at most {math.pi:.4f}")
    bound, most = -math.cos(angle), largest(projected_gravity[..., 2])

    def is_tilted() -> bool:
        return not most() <= bound  # true for NaN: a lost IMU is not an upright robot

    return is_tilted


def largest(values: NDArray[np.float32]) -> Callable[[], float]:
    """Return what reads the largest element; of a scalar its value, which is 8x faster."""
    return cast("Callable[[], float]", values.max if values.ndim else values.item)


def commanded(
    velocity_command: Reads, *, period: float, least: float = 0.05, hold: float = 1.0
) -> Commanded:
    """Hold while somebody commands a motion, and a while longer.

    Args:
        velocity_command: vx, vy in [m/s], wz in [rad/s], shape (..., 3).
        least: a magnitude below this is not a command, in [m/s] or [rad/s].
        hold: for how long it holds after the last command in [s].
    """
    return Commanded(velocity_command, least, ticks_of(hold, period, "hold") or 1)


class Commanded:
    """The tick of `commanded`."""

    memory = ("_left",)

    def __init__(self, command: NDArray[np.float32], least: float, ticks: int) -> None:
        self._command, self._least, self._ticks = command.reshape(-1), least, ticks
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


def settled(
    joint_vel: Reads, *, period: float, velocity: float = 0.1, duration: float = 0.5
) -> Settled:
    """Hold once every joint has been slow for some time.

    Args:
        joint_vel: in [rad/s], shape (..., n).
        velocity: what counts as slow in [rad/s].
        duration: for how long in [s].
    """
    return Settled(joint_vel, velocity, ticks_of(duration, period, "duration") or 1)


class Settled:
    """The tick of `settled`."""

    memory = ("_slow",)

    def __init__(self, joint_vel: NDArray[np.float32], velocity: float, ticks: int) -> None:
        self._vel, self._bound, self._ticks = joint_vel, velocity, ticks
        self._speed = np.zeros_like(joint_vel)
        self._slow = 0

    def __call__(self) -> bool:
        np.abs(self._vel, out=self._speed)
        self._slow = self._slow + 1 if self._speed.max() <= self._bound else 0
        return self._slow >= self._ticks

    def reset(self) -> None:
        """Wait anew."""
        self._slow = 0
