"""What platforms declare, what may not be driven on them, and the `scene:` that they get."""

from __future__ import annotations

from dataclasses import replace
from inspect import isclass, signature
from typing import Any

import numpy as np

from unicon_base import AnyDict, PlatformError, RobotError, WorkflowError, alternatives
from unicon_core.platforms.kit.scene import DISTURBANCES, Scene
from unicon_core.platforms.platform import Facts, Platform, WaitsForData
from unicon_core.robots import Robot, joint_index
from unicon_core.robots.load import JOINT_PHYSICS, joint_physics
from unicon_core.robots.robot import JOINT_ORDER
from unicon_core.states import States
from unicon_core.workflow.autowire import BuildContext
from unicon_core.workflow.document import WorkflowDocument, read_part
from unicon_core.workflow.registry import Factory, product_of

UNDECLARED = "it declares no facts: what it measures is known only once it is opened"


def declared_facts(factory: Factory, name: str) -> Facts:
    """Return the facts that a factory, or the class that it says it returns, declares.

    What declares nothing counts as a robot that takes commands and measures its joints.

    Args:
        factory: of the platform.
        name: word that the workflow uses.
    """
    for source in (factory, product_of(factory)):
        facts = getattr(source, "facts", None)
        if isinstance(facts, Facts):
            return facts if facts.name else replace(facts, name=name)
    return Facts(name, notes=(UNDECLARED,))


def can_wait(factory: Factory) -> bool:
    """Return whether ticks may come with a platform's data: not if its class says that it cannot.

    Args:
        factory: of the platform; one that does not say what it returns may.
    """
    made = product_of(factory)
    return not isclass(made) or made is Platform or issubclass(made, WaitsForData)


def checked(platform: Any, declared: Facts, states: States) -> Platform:
    """Return what a factory returned, if it is a platform that keeps to what it declared.

    Raises:
        PlatformError: it lacks a method, or its facts are wrong.
    """
    facts, wrong = getattr(platform, "facts", None), ""
    lacks = [m for m in ("recv", "send", "close") if not callable(getattr(platform, m, None))]
    if not lacks and (facts is None or (isinstance(facts, Facts) and not facts.name)):
        facts = declared if facts is None else replace(facts, name=declared.name)
        try:
            platform.facts = facts
        except AttributeError:  # an object with slots
            facts = getattr(platform, "facts", None)
    if lacks:
        wrong = f"has no {' and no '.join(lacks)}; a platform has recv(), send() and close()"
    elif not isinstance(facts, Facts):
        wrong = (
            f"has facts of type {type(facts).__name__}; "
            "give it facts = Facts(…) of unicon_core.platforms.platform"
        )
    elif facts.simulated != declared.simulated:
        wrong = (
            f"says simulated={facts.simulated} and the factory {declared.simulated}; say it "
            "once, in `facts` of the class, and annotate the factory with that class (-> Class)"
        )
    else:
        for use in ("reads", "writes"):
            for state in getattr(facts, use):
                if state not in states and not wrong:
                    known = alternatives(state, states)
                    wrong = f"{use} {state!r}, which is not a state; {known}"
    if wrong:
        made = f"what its factory returned, a {type(platform).__name__},"
        raise PlatformError(f"platform {declared.name!r}: {made} {wrong}")
    keeps: Platform = platform
    return keeps


def refuse_incomplete(robot: Robot, platform: str) -> None:
    """Refuse to drive a real robot whose file lacks a fact; nothing has been opened yet.

    Raises:
        RobotError: the file lacks motor order, a limit, a gain, the pose, the IMU or the protocol.
    """
    missing = robot.missing_facts()
    if missing:
        order = any(fact.startswith("joint_order") for fact in missing)  # also "… of MEMBER"
        raise RobotError(
            f"robot {robot.name} cannot be driven on platform {platform!r}: {robot.path} does not "
            f"say {', '.join(missing)}; find it in the vendor's documents and add it with its "
            f"source{f' (joint_order: {JOINT_ORDER})' if order else ''}, or simulate: "
            "platform=mujoco"
        )


def refuse_loud(factory: Factory, platform: str) -> None:
    """Refuse to open a robot silently that would send at its end; nothing has been opened yet.

    Raises:
        PlatformError: its factory has no parameter `silent`.
    """
    if "silent" not in signature(factory).parameters:
        raise PlatformError(
            f"platform {platform!r} cannot be opened to receive only: its factory has no parameter "
            "`silent`, so that its close() would damp the motors; give it one "
            "(docs/reference/platforms.md), or use a simulator"
        )


def refuse_protocol(robot: Robot, platform: str, facts: Facts) -> None:
    """Refuse a robot that speaks another protocol than the platform; nothing has been opened yet.

    Raises:
        RobotError: the robot file names another one.
    """
    for each in robot.members.values() or (robot,):
        protocol = each.transport.get("protocol")
        if facts.protocols and protocol is not None and protocol not in facts.protocols:
            raise RobotError(
                f"robot {each.name} speaks {protocol} ({each.path}), and platform {platform!r} "
                f"only {', '.join(facts.protocols)}; choose the robot's platform"
            )


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

    values: AnyDict = document.get("scene", {})
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
    pose, robot = values.get("initial_pose"), context.robot
    if isinstance(pose, str) and pose.startswith("policy:"):
        # The default pose of the policy in the robot's order, other joints standing.
        name = pose.removeprefix("policy:")
        if name not in context.policies:
            known = alternatives(name, context.policies)
            text = f"scene.initial_pose is {pose!r}, and there is no policy {name!r}; {known}"
            raise document.error(text, "scene", "initial_pose")
        contract, joints = context.policies[name], np.nan_to_num(robot.default_joint_pos)
        joints[joint_index(contract.joints, robot.joint_names)] = contract.default_joint_pos
        scene = replace(scene, pose=joints)
    try:
        scene = replace(scene, folder=context.relative_to)
        if not scene.posed_by_model:
            scene.joint_pos(robot)
        physics = joint_physics(robot, scene.joints)
    except (PlatformError, RobotError, WorkflowError) as error:
        raise document.error(str(error), "scene") from error
    if not facts.simulated:
        return scene
    for word in physics.words:
        if word not in facts.physics:
            able = ", ".join(filter(JOINT_PHYSICS.__contains__, facts.physics))
            raise document.error(
                f"platform {facts.name!r} simulates no {word} of joints (it can: "
                f"{able or 'nothing of joints'}); take it out of scene.joints or of `simulated` in "
                f"{robot.overlay or robot.path}, or choose platform: mujoco",
                *(("scene", "joints") if scene.joints else ("robot",)),
            )
    for word in scene.bodies:
        if word not in facts.physics:
            raise document.error(
                f"platform {facts.name!r} cannot be told scene.{word}; take it out of scene, or "
                "choose platform: mujoco",
                "scene",
                word,
            )
    return scene
