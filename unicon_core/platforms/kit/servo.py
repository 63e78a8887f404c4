"""Joint servos in NumPy, and motors that are weak or late, for simulators and robots."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from unicon_base.arrays import Array, Float64, Int64
from unicon_core.robots.load import JointPhysics


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


def strength_of(physics: JointPhysics) -> Float64 | None:
    """Return the factor on each motor's torque, shape (n,); None where all are 1."""
    strength = np.where(np.isnan(physics.strength), 1.0, physics.strength)
    return None if (strength == 1.0).all() else strength


def delay_of(physics: JointPhysics, timestep: float) -> Int64 | None:
    """Return each joint's delay in physics steps, shape (n,); None where all are 0.

    Args:
        physics: says it in [s].
        timestep: of the physics in [s].
    """
    delay = np.rint(np.nan_to_num(physics.delay) / timestep).astype(np.int64)
    return delay if delay.any() else None


class JointDelay:
    """The command of each physics step where joints get theirs late, each by its own delay.

    Args:
        rows: the present command as of `Command.rows`, shape (5, ..., n); read at each call.
        delay: in physics steps, shape (n,).
        decimation: physics steps in a tick.
    """

    memory = ("_past", "_tick")

    def __init__(self, rows: Array, delay: Int64, decimation: int) -> None:
        self._rows = rows
        ticks, begin = np.divmod(delay, decimation)
        edges = sorted({0, decimation, *begin.tolist()})
        # In the steps before a joint's `begin` the command of one tick earlier still acts.
        self._parts = [(end - start, ticks + (start < begin)) for start, end in pairwise(edges)]
        self._past = np.zeros((int(ticks.max()) + 2, *rows.shape), rows.dtype)
        self._joints = np.arange(rows.shape[-1])
        self._order = (*range(1, rows.ndim), 0)
        self.reset()

    def __call__(self) -> Iterator[tuple[int, Array]]:
        """Take the present command; yield physics steps and the command that acts in them."""
        depth = len(self._past)
        if self._tick == 0:  # before the first command arrives the motors hold what it says
            self._past[...] = self._rows
        self._past[self._tick % depth] = self._rows
        for steps, ages in self._parts:
            late = self._past[(self._tick - ages) % depth, ..., self._joints]
            yield steps, late.transpose(self._order)
        self._tick += 1

    def reset(self) -> None:
        """Begin anew with the next command."""
        self._tick = 0
