"""What a simulator is told of a robot's joints: strength, friction, armature and delay.

scene: {joints: {RL_calf_joint: {strength: 0.5, friction: 2.0}, "*": {delay: 0.004}}}
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from unicon_core.robots.file import Figures
from unicon_core.robots.poses import joints_like
from unicon_core.robots.robot import Robot
from unicon_core.schema.records import record_of

JOINT_PHYSICS = {name: field.type.unit for name, field in record_of(Figures).fields.items()}  # type: ignore[attr-defined]
"""Word to unit."""

Said = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True, eq=False)
class JointPhysics:
    """What is said of each joint: float64, shape (n,), NaN where the model's own value stays."""

    strength: NDArray[np.float64]
    friction: NDArray[np.float64]
    armature: NDArray[np.float64]
    delay: NDArray[np.float64]

    @property
    def words(self) -> list[str]:
        """What is said of any joint, in the order of `JOINT_PHYSICS`."""
        return [word for word in JOINT_PHYSICS if not np.isnan(getattr(self, word)).all()]


def joint_physics(robot: Robot, said: Said) -> JointPhysics:
    """Return what is said of a robot's joints: what the robot file says, then `said` over it.

    Args:
        robot: the robot.
        said: joint names and patterns to word and figure; of two that meet the later one counts.

    Raises:
        WorkflowError: no such joint.
    """
    arrays = {word: np.full(robot.num_joints, np.nan) for word in JOINT_PHYSICS}
    for each in (robot.simulated, said):
        for pattern, figures in each.items():
            joints = joints_like(pattern, robot)
            for word, figure in figures.items():
                arrays[word][joints] = figure
    return JointPhysics(**arrays)
