"""The platform of a workflow: found, its options checked, built; for builder and `check`."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from unicon_base import (
    AnyDict,
    MissingDependencyError,
    PlatformError,
    RobotError,
    TextSink,
    UniconError,
    WorkflowError,
    alternatives,
)
from unicon_core.platforms.child.platform import ChildPlatform
from unicon_core.platforms.joined import JoinedPlatform, joined_facts
from unicon_core.platforms.kit.disturbances import disturb
from unicon_core.platforms.kit.scene import SCENE_KEYS, Scene
from unicon_core.platforms.platform import SIMULATED, Binding, Facts, Platform
from unicon_core.robots import Robot
from unicon_core.robots.load import joint_physics
from unicon_core.workflow.autowire import BuildContext, option_names, read_options
from unicon_core.workflow.document import WorkflowDocument
from unicon_core.workflow.hardware import (
    UNDECLARED,
    checked,
    declared_facts,
    read_scene,
    refuse_incomplete,
    refuse_loud,
    refuse_protocol,
)
from unicon_core.workflow.members import (
    PlatformUse,
    member_context,
    member_robot,
    read_members,
    read_platforms,
    scene_of_member,
)
from unicon_core.workflow.registry import Factory, find_factory, known

if TYPE_CHECKING:
    from unicon_core.latches import Latch


@dataclass(frozen=True)
class Chosen:
    """A platform that a workflow names: how it says it, the factory behind the name, its facts."""

    use: PlatformUse
    factory: Factory
    facts: Facts


def build_platform(
    document: WorkflowDocument, context: BuildContext, *, dry: bool = False, silent: bool = False
) -> Platform:
    """Build the platform that a workflow names, or those of its robot's members as one.

    Args:
        document: the workflow.
        context: what it is built with.
        dry: nothing is opened: in place of hardware stands `fake`, which reads and writes the same.
        silent: of a robot nothing is opened that sends.

    Raises:
        PlatformError: no such platform, it cannot be built, it does not keep the contract, or it
            cannot be silent.
        RobotError: it moves motors, and the robot file lacks facts for that (not if `dry`).
        WorkflowError: wrong options.
    """
    chosen = find_platforms(document)
    facts = facts_of_all(chosen)
    options = platform_options(document, chosen)
    if context.states.num_robots is not None and not facts.batch:
        text = f"platform {facts.name!r} has one robot; leave num_robots out"
        raise document.error(text, "num_robots")
    for member, each in chosen.items():
        robot = member_robot(context.robot, member)
        if not each.facts.simulated:
            if not dry:
                refuse_incomplete(robot, each.use.name)
            refuse_protocol(robot, each.use.name, each.facts)
        if silent and not dry and each.facts.simulated != facts.simulated:
            raise document.error(
                f"platform: {member} is simulated and others are not: a simulation without "
                "commands falls, so it cannot be silent (--dry, preflight); give every member a "
                "robot's platform, or a simulator",
                "platform",
            )

    def opened(member: str, context: BuildContext, scene: Scene) -> Platform:
        use, factory, facts = chosen[member].use, chosen[member].factory, chosen[member].facts
        given: AnyDict = {"relative_to": context.relative_to, "scene": scene}
        if silent and not facts.simulated and not dry:
            refuse_loud(factory, use.name)
            given["silent"] = True
        known = inspect.signature(factory).parameters
        arguments = options[member] | {k: v for k, v in given.items() if k in known}
        place = context.states, context.robot, context.period
        try:
            if dry and not facts.simulated:
                return _stand_in(facts, context, arguments)
            if use.child is None or dry:
                built = factory(*place, **arguments)
            else:
                silence, watchdog = use.child.silence, use.child.watchdog
                built = ChildPlatform(
                    factory, facts, *place, arguments, silence=silence, watchdog=watchdog
                )
        except (TypeError, ValueError) as error:
            text = f"platform {use.name!r}: {error}; correct platforms.{use.name}"
            raise document.error(text, "platforms", use.name) from error
        try:
            return checked(built, facts, context.states)
        except UniconError:
            close = getattr(built, "close", None)
            if callable(close):  # it is open by now
                close()
            raise

    scene = read_scene(document, context, facts)
    if "" in chosen:
        platform = opened("", context, scene)
    else:
        platform = _of_members(document, chosen, context, scene, opened)
    try:
        return disturb(platform, scene, context.states, context.robot, context.period)
    except PlatformError as error:
        platform.close()  # it is open by now
        raise document.error(str(error), "scene") from error


def _of_members(
    document: WorkflowDocument,
    chosen: Mapping[str, Chosen],
    context: BuildContext,
    scene: Scene,
    opened: Callable[[str, BuildContext, Scene], Platform],
) -> Platform:
    built: dict[str, Platform] = {}
    try:
        for member, each in chosen.items():
            own = member_context(context, member)
            begin = scene_of_member(scene, context.robot, member)
            words = joint_physics(own.robot, begin.joints).words
            unable = [word for word in words if word not in each.facts.physics]
            if unable and each.facts.simulated:
                raise document.error(
                    f"platform {each.use.name!r} of {member} simulates no {unable[0]} of joints; "
                    "name joints of another member in scene.joints, or choose platform: mujoco",
                    "scene",
                )
            try:
                built[member] = opened(member, own, begin)
            except (PlatformError, RobotError) as error:
                raise type(error)(f"{member}: {error}") from error
        return JoinedPlatform(built, context.robot, context.states)
    except BaseException:
        for platform in built.values():
            with suppress(Exception):
                platform.close()
        raise


def _stand_in(facts: Facts, context: BuildContext, arguments: AnyDict) -> Platform:
    """Return `fake`, with what the hardware would read and write."""
    from unicon_core.platforms.fake import make

    place = context.states, context.robot, context.period
    # What nobody has said yet is not a finding.
    bound = Binding(replace(facts, writes=SIMULATED) if UNDECLARED in facts.notes else facts)
    if facts.examine is not None:
        bound = facts.examine(*place, **arguments)
    platform = make(*place)
    platform.facts = bound.facts
    if bound.require is not None:
        setattr(platform, "require", bound.require)  # noqa: B010  the fake has none
    return platform


def find_platforms(document: WorkflowDocument) -> dict[str, Chosen]:
    """Return the platforms of a workflow: member to platform, or "" to that of the whole robot.

    Raises:
        WorkflowError: no such platform.
        MissingDependencyError: it needs a package that is not installed.
    """
    chosen = {}
    for member, use in read_platforms(document).items():
        try:
            factory = find_factory("platforms", use.name, PlatformError)
        except PlatformError as error:
            raise document.error(str(error), *use.path) from error
        chosen[member] = Chosen(use, factory, declared_facts(factory, use.name))
    return chosen


def facts_of_all(chosen: Mapping[str, Chosen]) -> Facts:
    """Return the facts of a workflow's platforms, joined where there are several."""
    if "" in chosen:
        return chosen[""].facts
    return joined_facts({member: each.facts for member, each in chosen.items()})


def latch_keys(document: WorkflowDocument, robot: Robot) -> tuple[str, ...]:
    """Return what the latches of the robots that a workflow drives are named by.

    Simulators have none. A factory whose options do not tell one robot from another has an
    attribute `reached`: it takes them and returns the name.
    """
    chosen = find_platforms(document)
    if all(each.facts.simulated for each in chosen.values()):
        return ()
    from unicon_core.latches import robot_key  # of robots only

    options, keys = platform_options(document, chosen), []
    for member, each in chosen.items():
        reached, said = getattr(each.factory, "reached", None), options[member]
        if reached is not None:
            keys.append(str(reached(said)))
        elif not each.facts.simulated:
            own = member_robot(robot, member)
            keys.append(robot_key(each.use.name, each.facts.protocols, said, own))
    return tuple(dict.fromkeys(keys))


def latches_of(document: WorkflowDocument, robot: Robot, warn: TextSink) -> list[Latch]:
    """Return the latches of the robots that a workflow drives, before anything is opened.

    Raises:
        PlatformError: an emergency stop of one is latched.
    """
    found = []
    for key in latch_keys(document, robot):
        from unicon_core.latches import ESTOP, Latch, clearing, of_robot  # of robots only

        latched = of_robot(key)
        if latched is not None:
            since = f"since {latched.at}: " if latched.at else ""
            raise PlatformError(
                f"the emergency stop of robot {latched.robot} is latched "
                f"({since}{latched.reason}); when it is safe to start again: "
                f"{clearing(latched.robot)}"
            )
        found.append(Latch("", 0, ESTOP, warn, key))
    return found


def platform_options(
    document: WorkflowDocument, chosen: Mapping[str, Chosen]
) -> dict[str, AnyDict]:
    """Return each platform's options of the workflow file, and check those of all others.

    What stands under a member's name goes before what stands under its platform's.

    Raises:
        WorkflowError: an unknown platform, or one has no such option.
    """
    members, registered = tuple(read_members(document)), known("platforms")
    used = {*members, *(each.use.name for each in chosen.values())}
    for other in document.get("platforms", {}):
        if other in used:
            continue
        if not isinstance(other, str) or (other not in registered and ":" not in other):
            names = alternatives(str(other), (*members, *registered))
            what = "platform or member" if members else "platform"
            text = f"platforms: no {what} {other!r}; {names}"
            raise document.error(text, "platforms", str(other))
        if ":" not in other:  # a module of somebody's, which may be elsewhere
            try:
                factory = find_factory("platforms", other, PlatformError)
            except (MissingDependencyError, PlatformError):
                continue  # it is not used
            _checked_options(document, other, factory)
    return {
        member: _checked_options(document, each.use.name, each.factory)
        | (_checked_options(document, member, each.factory) if member else {})
        for member, each in chosen.items()
    }


def _checked_options(document: WorkflowDocument, name: str, factory: Factory) -> AnyDict:
    options = document.get("platforms", {}).get(name) or {}
    for option in options:
        if option in SCENE_KEYS and option not in option_names(factory):
            raise document.error(
                f"platforms.{name}.{option} is meant for every simulator; write scene: "
                f"{{{option}: …}}",
                "platforms",
                name,
                option,
            )

    def wrong(text: str, *path: str) -> WorkflowError:
        return document.error(f"platform {name!r}{text}", "platforms", name, *path)

    return read_options(factory, options, wrong)
