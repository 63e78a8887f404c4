"""Standing: which feet of a robot stand, and how much what they say of its velocity is worth."""

from __future__ import annotations

import math

import numpy as np

from unicon_core.arrays import Array
from unicon_core.models.feet import GRAVITY, Feet
from unicon_core.robots import Robot

_LEAST, _SURE = 0.4, 0.8
"""Of an equal share of the weight: what a foot bears that surely hangs, and surely stands. A leg
that swings asks its joints for up to a third of it."""
_NEAR, _FAR = 0.01, 0.04
"""Over the lowest foot in [m]: a foot so high surely stands, and surely hangs, of an even floor."""
_FALLS = 0.3 * GRAVITY
"""What an accelerometer reads at most in the air, [m/s²]."""
_TOUCH, _SETTLES = 0.25, 0.05
"""What a foot moves though it stands, at its touchdown in [m/s], and the time in [s] in which that
goes: rubber and ground give way, and the foot slides until it bears."""


class Standing:
    """Tells of each foot whether it stands.

    The variance of a velocity that a leg tells is that of its joints' velocities times its length,
    the more the less surely the foot stands (Camurri et al., "Probabilistic Contact Estimation and
    Impact Detection for State Estimation of Quadruped Robots", RA-L 2017).

    Args:
        feet: of the robot, at any posture.
        robot: names them.
        joint_noise: standard deviation of the joints' velocities in [rad/s].
        threshold: of the feet's force sensors, or None.

    Attributes:
        contact: from 0 to 1, how surely each foot of the robot file stands, shape (len(feet),).
        any: whether one of them stands at all.
        height: of the base over the feet that stand in [m], None where none does.
    """

    memory = ("contact", "any", "height", "_since")

    def __init__(
        self, feet: Feet, robot: Robot, joint_noise: float, threshold: float | None
    ) -> None:
        self._feet, self._threshold = feet, threshold
        self._share = feet.weight / len(feet.names)
        self._rank = np.array([robot.feet.index(name) for name in feet.names], np.intp)
        pose, none = np.nan_to_num(robot.default_joint_pos), np.zeros(3)
        feet(np.array((1.0, 0.0, 0.0, 0.0)), none, pose, np.zeros_like(pose), None)
        lengths = np.linalg.norm(feet.position, axis=1)
        self._variances = ((joint_noise * lengths) ** 2).tolist()
        self.contact = np.zeros(len(robot.feet), np.float32)
        self.reset()

    def reset(self) -> None:
        """Begin anew: no foot has stood."""
        self._since = [0.0] * len(self._variances)
        self.any = False
        self.height: float | None = None
        self.contact[:] = 0.0

    def __call__(self, dt: float, pull: float, sensed: Array | None, torques: bool) -> list[float]:
        """Look at the feet.

        Args:
            dt: since the last look in [s].
            pull: what the accelerometer reads, its length squared in [m²/s⁴].
            sensed: by the feet's force sensors, in the order of the robot file, or None.
            torques: whether the feet's `force` is of now.

        Returns:
            The variance of each foot's velocity along an axis in [m²/s²], infinite for one that
            does not stand.
        """
        heights = self._feet.position[:, 2].tolist()
        sure = self._surely(heights, pull, sensed, torques)
        variances, whole, height = [], 0.0, 0.0
        for foot, share in enumerate(sure):
            if not share > 0.0:  # nor where it is not a number
                self._since[foot] = sure[foot] = 0.0
                variances.append(math.inf)
                continue
            touch = _TOUCH**2 * math.exp(-self._since[foot] / _SETTLES)
            variances.append(self._variances[foot] / (share * share) + touch)
            self._since[foot] += dt
            whole += share
            height -= share * heights[foot]
        self.any = whole > 0.0
        self.height = height / whole if self.any else None
        self.contact[self._rank] = sure
        return variances

    def _surely(
        self,
        heights: list[float],
        pull: float,
        sensed: Array | None,
        torques: bool,
    ) -> list[float]:
        """Return how surely each foot stands, from 0 to 1."""
        if sensed is not None and self._threshold is not None:
            return [float(f >= self._threshold) for f in sensed[self._rank].tolist()]
        if torques:
            least, span = _LEAST * self._share, (_SURE - _LEAST) * self._share
            return [min(max((f - least) / span, 0.0), 1.0) for f in self._feet.force.tolist()]
        if pull < _FALLS**2:
            return [0.0] * len(heights)
        high = min(heights) + _FAR
        return [min(max((high - at) / (_FAR - _NEAR), 0.0), 1.0) for at in heights]
