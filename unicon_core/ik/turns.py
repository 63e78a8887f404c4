"""Turns of plain floats, for targets and their errors: for so few NumPy takes longer."""

from __future__ import annotations

import math
from collections.abc import Sequence

Floats = Sequence[float]


def turn_between(a: Floats, b: Floats) -> tuple[float, float, float]:
    """Return the rotation vector [rad] that turns one orientation into another, the shorter way.

    Args:
        a: unit quaternion wxyz, that of a body.
        b: likewise, that which is wanted; the vector is in the axes that both are told in.
    """
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    w = bw * aw + bx * ax + by * ay + bz * az  # b times the conjugate of a
    x = bx * aw - bw * ax - by * az + bz * ay
    y = by * aw - bw * ay - bz * ax + bx * az
    z = bz * aw - bw * az - bx * ay + by * ax
    s = math.sqrt(x * x + y * y + z * z)
    factor = 2.0 * math.atan2(s, abs(w)) / s if s > 1e-9 else 2.0
    if w < 0.0:
        factor = -factor
    return factor * x, factor * y, factor * z


def turned_by(quat: Floats, velocity: Floats, duration: float) -> tuple[float, float, float, float]:
    """Return an orientation after a turn at constant velocity.

    Args:
        quat: unit quaternion wxyz.
        velocity: in [rad/s], in the axes that the quaternion leads to.
        duration: in [s].
    """
    w, x, y, z = quat
    i, j, k = velocity
    speed = math.sqrt(i * i + j * j + k * k)
    half = 0.5 * speed * duration
    c, s = math.cos(half), math.sin(half) / speed if speed > 1e-9 else 0.5 * duration
    i, j, k = s * i, s * j, s * k
    return (
        c * w - i * x - j * y - k * z,
        c * x + i * w + j * z - k * y,
        c * y + j * w + k * x - i * z,
        c * z + k * w + i * y - j * x,
    )
