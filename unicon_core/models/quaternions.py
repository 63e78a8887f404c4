"""Products of quaternions wxyz and vectors turned by them, for frames of links and cameras."""

from __future__ import annotations

import numpy as np

from unicon_base.arrays import Float64


def multiply(a: Float64, b: Float64) -> Float64:
    """Return the product of two quaternions wxyz, shape (…, 4)."""
    aw, av, bw, bv = a[..., :1], a[..., 1:], b[..., :1], b[..., 1:]
    real = aw * bw - (av * bv).sum(axis=-1, keepdims=True)
    return np.concatenate((real, aw * bv + bw * av + np.cross(av, bv)), axis=-1)


def rotate(quat: Float64, vector: Float64) -> Float64:
    """Return a vector turned by a unit quaternion wxyz, shape (3,)."""
    w, u = quat[0], quat[1:]
    turned: Float64 = vector + 2.0 * np.cross(u, np.cross(u, vector) + w * vector)
    return turned


def about(axis: Float64, angle: float) -> Float64:
    """Return the unit quaternion wxyz of a turn by an angle [rad] about a unit vector."""
    return np.concatenate(([np.cos(0.5 * angle)], np.sin(0.5 * angle) * axis))
