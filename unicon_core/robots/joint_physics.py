"""What a simulator is told of a robot's joints: strength, friction, armature and delay.

scene: {joints: {RL_calf_joint: {strength: 0.5, friction: 2.0}, "*": {delay: 0.004}}}
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from unicon_core.bounds import EFFORT
from unicon_core.errors import RobotError, alternatives
from unicon_core.robots.poses import joints_like
from unicon_core.robots.robot import Robot

JOINT_PHYSICS = {
    "strength": (5.0, "", "factor on the torque that the motor gives, and on its limit"),
    "friction": (EFFORT, "N·m", "torque of dry friction, whichever way the joint turns"),
    "armature": (10.0, "kg·m²", "inertia of the rotor, seen from the joint"),
    "delay": (1.0, "s", "by which commands reach the motor late, in whole physics steps"),
}
"""Word to the largest plausible figure, unit and meaning. Known motors have 0.5 to 1.2, up to 10
N·m, up to 0.2 kg·m² and up to 0.05 s."""

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
        RobotError: a figure is not plausible.
        WorkflowError: no such joint.
    """
    arrays = {word: np.full(robot.num_joints, np.nan) for word in JOINT_PHYSICS}
    for each in (robot.simulated, said):
        wrong = wrong_physics(each)
        if wrong is not None:
            raise RobotError(wrong)
        for pattern, figures in each.items():
            joints = joints_like(pattern, robot)
            for word, figure in figures.items():
                arrays[word][joints] = figure
    return JointPhysics(**arrays)


def wrong_physics(said: object) -> str | None:
    """Return what is wrong with joints and their figures; None for nothing."""
    example = "write {JOINT: {strength: 0.8, friction: 0.3}}"
    if not isinstance(said, Mapping):
        return f"joints are {said!r:.60}; {example}"
    for joint, figures in said.items():
        if not isinstance(joint, str) or not isinstance(figures, Mapping):
            return f"joint {joint!r:.60} is {figures!r:.60}; {example}"
        for word, figure in figures.items():
            if word not in JOINT_PHYSICS:
                return f"joint {joint!r} has no {word!r}; {alternatives(str(word), JOINT_PHYSICS)}"
            largest, unit, _ = JOINT_PHYSICS[word]
            number = isinstance(figure, (int, float)) and not isinstance(figure, bool)
            if not number or not math.isfinite(figure) or not 0.0 <= figure <= largest:
                end = f" [{unit}]" if unit else ""
                return f"{word} of joint {joint!r} is {figure!r:.40}; give 0 to {largest:g}{end}"
    return None
