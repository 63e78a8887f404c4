"""Joint servos in NumPy, for simulators and robots whose motors take torques."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[Any]


class Servo:
    """The PD equation that every motor follows, at each of its own steps:

        tau = kp (q* - q) + kd (qd* - qd) + tau_ff,   clipped to the effort limits.

    Args:
        rows: q*, qd*, tau_ff, kp, kd as of `Command.rows`, shape (5, ..., n), or five arrays of
            shape (..., n); read at each call.
        effort_limit: largest torque of each joint in [N·m], NaN for none, shape (n,).
        lower: smallest torque in [N·m], shape (n,); the opposite of the largest if None.

    Attributes:
        torque: of the last call in [N·m], shape (..., n).
    """

    def __init__(
        self,
        rows: Array | Sequence[Array],
        effort_limit: ArrayLike,
        lower: ArrayLike | None = None,
    ) -> None:
        self._rows = rows
        self._limit = np.nan_to_num(np.asarray(effort_limit, rows[0].dtype), nan=np.inf)
        self._lower = -self._limit if lower is None else np.asarray(lower, rows[0].dtype)
        self.torque: Array = np.zeros_like(rows[0])
        self._part = np.zeros_like(rows[0])

    def __call__(self, pos: Array, vel: Array) -> Array:
        """Return `torque` at measured positions [rad] and velocities [rad/s], shape (..., n)."""
        target, velocity, feed_forward, stiffness, damping = self._rows
        torque = self.torque
        np.subtract(target, pos, out=torque)
        torque *= stiffness
        np.subtract(velocity, vel, out=self._part)
        self._part *= damping
        self._part += feed_forward
        torque += self._part
        np.clip(torque, self._lower, self._limit, out=torque)
        return torque
