"""Settings of inverse kinematics: weights, distances and tolerances, for who builds it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from unicon_core.schema.marks import Within

Weight = Annotated[float, Within(0.0, 100.0)]
APART = 0.02
"""Between capsules in [m]: targets of arms that a walking robot swings are off by 4 to 12 mm."""


@dataclass(frozen=True)
class Weights:
    """How much an end effector's errors count against those of others."""

    position: Weight = 1.0
    """Of 1 m; 0 leaves it free."""
    orientation: Weight = 0.3
    """Of 1 rad: a hand that is 0.3 m wide moves its edge as far. 0 leaves it free."""


@dataclass(frozen=True)
class Settings:
    """What is the same in every tick."""

    posture: float = 0.02
    """Weight of 1 rad to the default pose, against an end effector's 1 m."""
    apart: float = APART
    """Distance in [m] that capsules keep; 0 lets them touch."""
    tolerance: tuple[float, float] = (0.005, 0.05)
    """Error in [m] and [rad] within which a target is reached."""
