"""Gate `imu`: orientation, gravity, accelerometer and gyroscope of a robot at rest agree."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.gates.gate import StartGate

GRAVITY = 9.81
"""In [m/s²]."""
ACCELERATION = 1.5
"""How far |accelerometer| may be from it at rest in [m/s²]: MEMS sensors are off by up to 0.5."""
NONSENSE = 500.0
"""No accelerometer of a robot shows more, [m/s²]; it would stay in the average for ever."""
ANGLE = 0.2
"""Largest angle between measured and reported gravity at rest, [rad]; a wrong axis gives π/2."""
TURNING = 0.5
"""A base that turns faster is not at rest, [rad/s]."""
NORM = 0.01
"""How far a quaternion's length may be from 1."""
SMOOTH = 0.2
"""Time over which the accelerometer is averaged in [s]: feet and fans shake it."""


class Imu:
    """See the module. What the platform does not tell is not looked at.

    Args:
        views: those of `base_quat` (wxyz), `projected_gravity`, `base_ang_vel` [rad/s] and
            `base_lin_acc` [m/s²] that are told, of one robot.
        needed: those of them that the command depends on. An accelerometer that is not, and says
            0 in all axes, is none.
        period: of a tick in [s].
        stop: tells of contradictions that a safety block looks for, or None.
    """

    name = "imu"

    def __init__(
        self,
        views: Mapping[str, NDArray[Any]],
        needed: Collection[str],
        period: float,
        stop: StartGate | None,
    ) -> None:
        self._quat, self._down = views.get("base_quat"), views.get("projected_gravity")
        self._gyro, self._acceleration = views.get("base_ang_vel"), views.get("base_lin_acc")
        self._need_acceleration = "base_lin_acc" in needed
        self._stop, self._draw = stop, min(period / SMOOTH, 1.0)
        self._mean: NDArray[np.float64] | None = None
        self.about = f"{', '.join(views)} agree at rest, gravity is {GRAVITY} m/s²"

    def __call__(self) -> str:
        """Look at what is told."""
        gyro = 0.0 if self._gyro is None else _norm(self._gyro)
        if not gyro <= TURNING:
            self._mean = None
            return (
                f"the base turns at {gyro:.2f} rad/s by base_ang_vel, at most {TURNING} rad/s are "
                "rest; hold the robot still, or correct the gyroscope's unit"
            )
        return self._orientation() or self._gravity()

    def _orientation(self) -> str:
        if self._quat is not None:
            norm = _norm(self._quat)
            if not abs(norm - 1.0) <= NORM:
                return (
                    f"base_quat has length {norm:.3f} instead of 1; correct the map's fields, or "
                    "wait until the IMU has found its orientation"
                )
        return "" if self._stop is None else self._stop()

    def _gravity(self) -> str:
        measured = self._acceleration
        if measured is None or not (measured.any() or self._need_acceleration):
            return ""
        now = _norm(measured)
        if not now <= NONSENSE:
            self._mean = None
            return (
                f"|base_lin_acc| is {now:g} m/s², which no sensor measures; correct the driver or "
                "the unit in the map"
            )
        if self._mean is None:
            self._mean = measured.astype(np.float64)
        self._mean += self._draw * (measured - self._mean)
        size = _norm(self._mean)
        if not abs(size - GRAVITY) <= ACCELERATION:
            return (
                f"|base_lin_acc| is {size:.2f} m/s² at rest, gravity is {GRAVITY} ± "
                f"{ACCELERATION}; hold the robot still, or correct what the sensor tells: 1 is in "
                "units of g, 0 has gravity taken out"
            )
        if self._down is None:
            return ""
        cosine = -float(self._mean @ self._down) / (size * _norm(self._down) or 1.0)
        angle = math.acos(max(-1.0, min(cosine, 1.0))) if math.isfinite(cosine) else math.pi
        if angle <= ANGLE:
            return ""
        return (
            f"gravity by base_lin_acc is {angle:.2f} rad away from projected_gravity, at most "
            f"{ANGLE} rad are plausible; correct axes and signs of the IMU in the driver or the map"
        )


def _norm(vector: NDArray[Any]) -> float:
    """Return the length; in double precision, which a float's garbage does not overflow."""
    return float(np.linalg.norm(vector.astype(np.float64)))
