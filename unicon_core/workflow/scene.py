"""The `scene:` of a workflow: its keys and values checked, for the builder of platforms."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from unicon_base.errors import PlatformError, RobotError, WorkflowError, alternatives
from unicon_core.platforms.kit.scene import DISTURBANCES, Scene
from unicon_core.platforms.platform import Facts
from unicon_core.robots import joint_index
from unicon_core.robots.poses import JOINT_PHYSICS, joint_physics
from unicon_core.workflow.autowire import BuildContext
from unicon_core.workflow.document import WorkflowDocument, read_part


def read_scene(document: WorkflowDocument, context: BuildContext, facts: Facts) -> Scene:
    """Return the scene of a workflow for a platform.

    A robot begins where it is, so that the same file runs on it; what would disturb it is refused.

    Args:
        document: the workflow.
        context: what it is built with.
        facts: of the platform.

    Raises:
        WorkflowError: an unknown key, a wrong value, or a disturbance that is meant for a robot.
    """
    values: dict[str, Any] = document.get("scene", {})
    for key in values:
        if key in DISTURBANCES and not facts.simulated:
            raise document.error(
                f"scene.{key} is for simulators, and platform {facts.name!r} is a robot; leave "
                f"{key} out, or simulate: platform: mujoco",
                "scene",
                key,
            )
    values = {key: value for key, value in values.items() if value is not None}
    scene: Scene = read_part(document, Scene, values, "scene")
    pose = values.get("initial_pose")
    if isinstance(pose, str) and pose.startswith("policy:"):
        scene = replace(scene, pose=_pose_of(pose, document, context))
    try:
        scene = replace(scene, folder=context.relative_to)
        if not scene.posed_by_model:
            scene.joint_pos(context.robot)
        physics = joint_physics(context.robot, scene.joints)
    except (PlatformError, RobotError, WorkflowError) as error:
        raise document.error(str(error), "scene") from error
    unable = [word for word in physics.words if word not in facts.physics]
    if facts.simulated and unable:
        able = ", ".join(filter(JOINT_PHYSICS.__contains__, facts.physics)) or "nothing of joints"
        file = context.robot.overlay or context.robot.path
        raise document.error(
            f"platform {facts.name!r} simulates no {unable[0]} of joints (it can: {able}); take it "
            f"out of scene.joints or of `simulated` in {file}, or choose platform: mujoco",
            *(("scene", "joints") if scene.joints else ("robot",)),
        )
    cannot = [word for word in scene.bodies if word not in facts.physics]
    if facts.simulated and cannot:
        raise document.error(
            f"platform {facts.name!r} cannot be told scene.{cannot[0]}; take it out of scene, or "
            "choose platform: mujoco",
            "scene",
            cannot[0],
        )
    return scene


def _pose_of(word: str, document: WorkflowDocument, context: BuildContext) -> Any:
    """Return the default pose of `policy:NAME` in the robot's order, others standing."""
    name = word.removeprefix("policy:")
    if name not in context.policies:
        known = alternatives(name, context.policies)
        raise document.error(
            f"scene.initial_pose is {word!r}, and there is no policy {name!r}; {known}",
            "scene",
            "initial_pose",
        )
    contract = context.policies[name]
    pose = np.nan_to_num(context.robot.default_joint_pos)
    pose[joint_index(contract.joints, context.robot.joint_names)] = contract.default_joint_pos
    return pose
