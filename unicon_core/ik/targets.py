"""Targets of end effectors: read of states, brought to the present, refused where they are none."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from numpy.typing import NDArray

from unicon_core.ik.tasks import Pose
from unicon_core.models.plain_turns import turned_by

LONGEST = 0.3
"""In [s], over which a target's velocity is believed: a hand turns round in as much."""
_UNIT = 0.05
"""By which the length of a quaternion may be off: float32 and averages of it are within 1e-3."""


class Target:
    """The target of one end effector.

    Args:
        effector: its name, for what is told.
        pose: position in [m] and quaternion wxyz, shape (7,).
        velocity: in [m/s] and [rad/s], shape (6,).
        stamp_ns: when it was true, 0 for now, shape ().
        turns: whether its orientation counts.
        look_ahead: in [s], by which it is brought on.
        tell: takes one line, once for each time that it is refused.
    """

    memory = ("_told",)

    def __init__(
        self,
        effector: str,
        pose: NDArray[Any],
        velocity: NDArray[Any],
        stamp_ns: NDArray[Any],
        turns: bool,
        look_ahead: float,
        tell: Callable[[str], None],
    ) -> None:
        self._effector, self._turns, self._tell = effector, turns, tell
        self._pose, self._velocity, self._stamp = pose, velocity, stamp_ns
        self._look_ahead, self._told = look_ahead, False

    def __call__(self, now_ns: int) -> Pose | None:
        """Return the target as it will be, None where there is none.

        Args:
            now_ns: time of the robot's data.
        """
        x, y, z, *quat = self._pose.tolist()
        if not self._turns:
            quat = [1.0, 0.0, 0.0, 0.0]
        if math.isnan(x + y + z) or any(map(math.isnan, quat)):
            self._told = False
            return None
        length = math.sqrt(sum(each * each for each in quat))
        if not (math.isfinite(x + y + z) and abs(length - 1.0) <= _UNIT):
            self._refuse([x, y, z], length)
            return None
        self._told = False
        quat = [each / length for each in quat]
        stamp = int(self._stamp)
        age = 1e-9 * (now_ns - stamp) if stamp else 0.0
        ahead = min(max(self._look_ahead + max(age, 0.0), 0.0), LONGEST)
        velocity = self._velocity.tolist()
        if not ahead or not all(map(math.isfinite, velocity)) or not any(velocity):
            return (x, y, z), quat
        vx, vy, vz, *turning = velocity
        place = (x + ahead * vx, y + ahead * vy, z + ahead * vz)
        return place, turned_by(quat, turning, ahead)

    def _refuse(self, place: list[float], length: float) -> None:
        if self._told:
            return
        self._told = True
        what = (
            f"position {place}"
            if not all(map(math.isfinite, place))
            else f"quaternion of length {length:.3g}"
        )
        self._tell(
            f"reach: {self._effector}_target has a {what}, which counts as no target; write finite "
            "[m] and a unit quaternion, w first, or NaN for none"
        )
