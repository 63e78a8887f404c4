"""Joint trajectories: points in time, what is refused of them, and who plays one; no ROS here."""

from unicon_core.trajectory.accepted import Limits, Points, Refusal, Start, accepted
from unicon_core.trajectory.player import Ending, Player, Tolerances
from unicon_core.trajectory.spline import Spline

__all__ = [
    "Ending",
    "Limits",
    "Player",
    "Points",
    "Refusal",
    "Spline",
    "Start",
    "Tolerances",
    "accepted",
]
