"""The platform of a workflow: found, its options checked, built; for builder and `check`."""

from __future__ import annotations

import inspect
from dataclasses import replace
from typing import Any

from unicon_core.errors import (
    MissingDependencyError,
    PlatformError,
    UniconError,
    WorkflowError,
    alternatives,
)
from unicon_core.platforms.child.platform import ChildPlatform
from unicon_core.platforms.kit.disturbances import disturb
from unicon_core.platforms.kit.scene import SCENE_KEYS
from unicon_core.platforms.platform import SIMULATED, Binding, Facts, Platform
from unicon_core.workflow.autowire import BuildContext, option_names, refuse_options
from unicon_core.workflow.document import WorkflowDocument
from unicon_core.workflow.hardware import (
    UNDECLARED,
    checked,
    declared_facts,
    refuse_incomplete,
    refuse_loud,
    refuse_protocol,
)
from unicon_core.workflow.platform_use import read_platform
from unicon_core.workflow.registry import Factory, find_factory, known
from unicon_core.workflow.scene import read_scene

__all__ = ["build_platform", "find_platform", "platform_options"]


def build_platform(
    document: WorkflowDocument, context: BuildContext, *, dry: bool = False, silent: bool = False
) -> Platform:
    """Build the platform that a workflow names.

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
    name, factory = find_platform(document)
    facts = declared_facts(factory, name)
    if not facts.simulated:
        if not dry:
            refuse_incomplete(context.robot, name)
        refuse_protocol(context.robot, name, facts)
    if context.states.num_robots is not None and not facts.batch:
        raise document.error(f"platform {name!r} has one robot; leave num_robots out", "num_robots")
    arguments = platform_options(document, name, factory)
    scene = read_scene(document, context, facts)
    parameters = inspect.signature(factory).parameters
    given: dict[str, Any] = {"relative_to": context.relative_to, "scene": scene}
    if silent and not facts.simulated and not dry:
        refuse_loud(factory, name)
        given["silent"] = True
    arguments |= {key: value for key, value in given.items() if key in parameters}
    try:
        if dry and not facts.simulated:
            return _stand_in(facts, context, arguments)
        child = read_platform(document).child
        if child is None or dry:
            built = factory(context.states, context.robot, context.period, **arguments)
        else:
            robot, period = context.robot, context.period
            built = ChildPlatform(factory, facts, context.states, robot, period, arguments, **child)
    except (TypeError, ValueError) as error:
        raise document.error(
            f"platform {name!r}: {error}; correct platforms.{name}", "platforms", name
        ) from error
    try:
        platform = checked(built, facts, context.states)
        try:
            return disturb(platform, scene, context.states, context.robot, context.period)
        except PlatformError as error:
            raise document.error(str(error), "scene") from error
    except UniconError:
        close = getattr(built, "close", None)
        if callable(close):  # it is open by now
            close()
        raise


def _stand_in(facts: Facts, context: BuildContext, arguments: dict[str, Any]) -> Platform:
    """Return `fake`, with what the hardware would read and write."""
    from unicon_core.platforms.fake import FakePlatform, make

    # What nobody has said yet is no finding.
    bound = Binding(replace(facts, writes=SIMULATED) if UNDECLARED in facts.notes else facts)
    if facts.examine is not None:
        bound = facts.examine(context.states, context.robot, context.period, **arguments)
    platform: FakePlatform = make(context.states, context.robot, context.period)
    platform.facts = bound.facts
    if bound.require is not None:
        setattr(platform, "require", bound.require)  # noqa: B010  the fake has none
    return platform


def find_platform(document: WorkflowDocument) -> tuple[str, Factory]:
    """Return the word that a workflow uses for its platform, and the factory behind it.

    Raises:
        WorkflowError: no such platform.
        MissingDependencyError: it needs a package that is not installed.
    """
    name = read_platform(document).name
    try:
        return name, find_factory("platforms", name, PlatformError)
    except PlatformError as error:
        raise document.error(str(error), "platform") from error


def platform_options(document: WorkflowDocument, name: str, factory: Factory) -> dict[str, Any]:
    """Return a platform's options of the workflow file, and check those of all others.

    Raises:
        WorkflowError: an unknown platform, or one has no such option.
    """
    every = document.get("platforms", dict, {})
    for other in every:
        if other == name:
            continue
        if not isinstance(other, str) or (other not in known("platforms") and ":" not in other):
            names = alternatives(str(other), known("platforms"))
            raise document.error(
                f"platforms: no platform {other!r}; {names}", "platforms", str(other)
            )
        if ":" not in other:  # a module of somebody's, which may be elsewhere
            try:
                found = find_factory("platforms", other, PlatformError)
            except (MissingDependencyError, PlatformError):
                continue  # it is not used
            _checked_options(document, other, found)
    return _checked_options(document, name, factory)


def _checked_options(document: WorkflowDocument, name: str, factory: Factory) -> dict[str, Any]:
    options = document.get("platforms", dict, {}).get(name) or {}

    def wrong(text: str, *path: str) -> WorkflowError:
        return document.error(text, "platforms", name, *path)

    if not isinstance(options, dict):
        raise wrong(f"platforms.{name}: {options!r} is not a mapping of options")
    free = option_names(factory)
    for option in options:
        if option in SCENE_KEYS and option not in free:
            raise wrong(
                f"platforms.{name}.{option} is meant for every simulator; write scene: "
                f"{{{option}: …}}",
                option,
            )
    refuse_options(factory, options, lambda text, *path: wrong(f"platform {name!r}{text}", *path))
    return dict(options)
