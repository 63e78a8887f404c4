"""Turns of plain floats: quaternions wxyz and vectors as tuples, for what computes a few in a tick.

NumPy takes longer for arrays so small: one product is 0.6 us here and 20 us in `quaternions`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeAlias

Quat: TypeAlias = tuple[float, float, float, float]
Vector: TypeAlias = tuple[float, float, float]


def multiply(a: Quat, b: Quat) -> Quat:
    """Return the product of two quaternions wxyz."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def conjugate(a: Quat) -> Quat:
    """Return the inverse of a unit quaternion wxyz."""
    return a[0], -a[1], -a[2], -a[3]


def rotate(a: Quat, v: Vector) -> Vector:
    """Return a vector turned by a unit quaternion wxyz."""
    _, x, y, z = multiply(multiply(a, (0.0, *v)), conjugate(a))
    return x, y, z


def turned(axis: Vector, angle: float) -> Quat:
    """Return the quaternion wxyz of a turn by an angle in [rad] about a unit vector."""
    half = 0.5 * angle
    s = math.sin(half) if math.isfinite(half) else math.nan
    c = math.cos(half) if math.isfinite(half) else math.nan
    return c, s * axis[0], s * axis[1], s * axis[2]


def yaw_of(a: Quat) -> float:
    """Return the heading of a unit quaternion wxyz in [rad]: the last of roll, pitch and yaw."""
    w, x, y, z = a
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def vector_of(a: Quat) -> Vector:
    """Return the rotation vector of a unit quaternion wxyz in [rad], the shorter way round."""
    w, x, y, z = a if a[0] >= 0.0 else (-a[0], -a[1], -a[2], -a[3])
    s = math.sqrt(x * x + y * y + z * z)
    factor = 2.0 * math.atan2(s, w) / s if s > 1e-9 else 2.0
    return factor * x, factor * y, factor * z


def towards(a: Quat, b: Quat, share: float) -> Quat:
    """Return the unit quaternion wxyz that is a share of the shorter way from one to another.

    Shoemake 1985, "Animating rotation with quaternion curves", as a turn about one axis. Its sign
    is that of the first one.
    """
    x, y, z = vector_of(multiply(b, conjugate(a)))
    angle = math.sqrt(x * x + y * y + z * z)
    if angle < 1e-9:
        return a
    w, i, j, k = multiply(turned((x / angle, y / angle, z / angle), share * angle), a)
    length = math.sqrt(w * w + i * i + j * j + k * k)
    return w / length, i / length, j / length, k / length


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
