"""Block `projected_gravity`: where gravity points, for platforms that give only an orientation."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from unicon_base.arrays import Float32
from unicon_core.flow.block import Reads, Writes


def projected_gravity(base_quat: Reads, projected_gravity: Writes) -> Callable[[], None]:
    """Turn the unit vector of gravity into the base frame: g = R(q)ᵀ (0, 0, -1).

    Args:
        base_quat: unit quaternion wxyz, base to world, shape (..., 4).
        projected_gravity: shape (..., 3).
    """
    if base_quat.ndim > 1:
        return BatchGravity(base_quat, projected_gravity)

    def of_one_robot() -> None:  # 0.6 µs; the arrays' way takes 6.3 for any N
        w, x, y, z = base_quat.tolist()
        projected_gravity[:] = (
            2.0 * (w * y - x * z),
            -2.0 * (w * x + y * z),
            2.0 * (x * x + y * y) - 1.0,
        )

    return of_one_robot


class BatchGravity:
    """The tick of `projected_gravity` for many robots; the third row of R(q), negated."""

    memory = ()

    def __init__(self, quat: Float32, out: Float32) -> None:
        self._w, self._x, self._y, self._z = (quat[..., i] for i in range(4))
        self._parts = tuple(out[..., i] for i in range(3))
        self._first, self._second = (np.zeros(quat.shape[:-1], np.float32) for _ in range(2))

    def __call__(self) -> None:
        first, second = self._first, self._second
        (gx, gy, gz), (w, x, y, z) = self._parts, (self._w, self._x, self._y, self._z)
        np.multiply(w, y, out=first)
        np.multiply(x, z, out=second)
        np.subtract(first, second, out=first)
        np.multiply(first, 2.0, out=gx)
        np.multiply(w, x, out=first)
        np.multiply(y, z, out=second)
        np.add(first, second, out=first)
        np.multiply(first, -2.0, out=gy)
        np.multiply(x, x, out=first)
        np.multiply(y, y, out=second)
        np.add(first, second, out=first)
        np.multiply(first, 2.0, out=first)
        np.subtract(first, 1.0, out=gz)
