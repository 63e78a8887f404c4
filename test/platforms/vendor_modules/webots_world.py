"""A world of Webots for whatever robot a test makes; what its user would have made by hand."""

from __future__ import annotations

from typing import Any

import controller

from unicon_core.models.kinematic_tree import physical_urdf
from unicon_core.platforms.kit.scene import Scene
from unicon_core.platforms.kit.start import start_of
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_sims.webots import platform


def make(
    states: States, robot: Robot, period: float, *, scene: Scene, **options: Any
) -> platform.WebotsPlatform:
    """Let Webots load the robot's world, then build the platform in a process of its own."""
    start = start_of(robot, scene)
    wbt = controller.Wbt(physical_urdf(start.loaded, robot), 1.0, not start.floating)
    controller.WORLD.append(wbt)
    platform._HELD.clear()
    platform._SUPERVISORS.clear()
    return platform.make(states, robot, period, scene=scene, **options)


make.facts = platform.WebotsPlatform.facts  # type: ignore[attr-defined]
