"""One-Euro filter of a pose, for hands that tremble: slow movements are smoothed, quick ones not.

Casiez, Roussel, Vogel 2012, "1€ Filter: A Simple Speed-based Low-pass Filter for Noisy Input in
Interactive Systems", CHI: the cut-off frequency rises with the speed, which is itself smoothed.
"""

from __future__ import annotations

import math

from unicon_core.models.plain_turns import Quat, Vector, conjugate, multiply, towards, vector_of

SPEED_CUTOFF = 1.0
"""Of the speed itself in [Hz], as in the paper."""


class OneEuro:
    """Smooths a pose.

    Args:
        cutoff: of a hand that keeps still in [Hz].
        slope: by how much the cut-off rises with the speed, in [Hz] for 1 m/s, or 1 rad/s.
    """

    memory = ("_position", "_quat", "_speed", "_turn")

    def __init__(self, cutoff: float, slope: float) -> None:
        self._cutoff, self._slope = cutoff, slope
        self._position: Vector | None = None
        self._quat: Quat = (1.0, 0.0, 0.0, 0.0)
        self._speed = self._turn = 0.0

    def reset(self) -> None:
        """Begin with the next pose."""
        self._position = None
        self._speed = self._turn = 0.0

    def __call__(self, position: Vector, quat: Quat, dt: float) -> tuple[Vector, Quat]:
        """Return the smoothed pose: position in [m], quaternion wxyz.

        Args:
            position: in [m].
            quat: unit quaternion wxyz.
            dt: since the last pose in [s], more than 0.
        """
        last = self._position
        if last is None:
            self._position, self._quat = position, quat
            return position, quat
        slow = _alpha(SPEED_CUTOFF, dt)
        self._speed += slow * (math.dist(position, last) / dt - self._speed)
        angle = math.hypot(*vector_of(multiply(quat, conjugate(self._quat))))
        self._turn += slow * (angle / dt - self._turn)
        near = _alpha(self._cutoff + self._slope * self._speed, dt)
        x, y, z = (a + near * (b - a) for a, b in zip(last, position))
        self._position = x, y, z
        share = _alpha(self._cutoff + self._slope * self._turn, dt)
        self._quat = towards(self._quat, quat, share)
        return self._position, self._quat


def _alpha(cutoff: float, dt: float) -> float:
    """Return the share of a new value: 1 / (1 + tau / dt), tau = 1 / (2 pi cutoff)."""
    return 1.0 / (1.0 + 1.0 / (2.0 * math.pi * cutoff * dt))
