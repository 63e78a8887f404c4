"""The platform of a workflow: found, its options checked, built; for builder and `check`."""

from __future__ import annotations

import inspect
from typing import Any

from unicon_core.errors import PlatformError, alternatives
from unicon_core.platforms.platform import Binding, Platform
from unicon_core.workflow.autowire import BuildContext, option_names
from unicon_core.workflow.document import WorkflowDocument
from unicon_core.workflow.hardware import is_simulator, refuse_incomplete, refuse_protocol
from unicon_core.workflow.option_types import wrong_option
from unicon_core.workflow.registry import Factory, find_factory

__all__ = ["build_platform", "find_platform", "platform_options"]


def build_platform(
    document: WorkflowDocument, context: BuildContext, *, dry: bool = False
) -> Platform:
    """Build the platform that a workflow names.

    A factory of hardware may say by attributes what is known without opening it: `protocols`, those
    of robot files that it speaks, and `examine`, which takes what the factory takes and returns
    what the platform would read and write (a `Binding`).

    Args:
        document: the workflow.
        context: what it is built with.
        dry: nothing is opened: in place of hardware stands `fake`, which reads and writes the same.

    Raises:
        PlatformError: no such platform, or it cannot be built.
        RobotError: it moves motors, and the robot file lacks facts for that (not if `dry`).
        WorkflowError: wrong options.
    """
    name, factory = find_platform(document)
    simulator = is_simulator(name, factory)
    if not simulator:
        if not dry:
            refuse_incomplete(context.robot, name)
        refuse_protocol(context.robot, name, factory)
    options = platform_options(document, name, factory)
    arguments = {key: _pose_of(value, document, context) for key, value in options.items()}
    wrong = wrong_option(factory, arguments)
    if wrong:
        raise document.error(f"platform {name!r}: {wrong}", "platforms", name)
    if "relative_to" in inspect.signature(factory).parameters:
        arguments["relative_to"] = context.relative_to
    try:
        if dry and not simulator:
            return _stand_in(factory, context, arguments)
        platform: Platform = factory(context.states, context.robot, context.period, **arguments)
    except (TypeError, ValueError) as error:
        raise document.error(
            f"platform {name!r}: {error}; correct platforms.{name}", "platforms", name
        ) from error
    return platform


def _stand_in(factory: Factory, context: BuildContext, arguments: dict[str, Any]) -> Platform:
    """Return `fake`, with what the hardware would read and write where its factory tells."""
    from unicon_core.platforms import fake

    platform = fake.make(context.states, context.robot, context.period)
    platform.writes = tuple(getattr(factory, "writes", platform.writes))
    examine = getattr(factory, "examine", None)
    if examine is not None:
        bound: Binding = examine(context.states, context.robot, context.period, **arguments)
        platform.reads, platform.writes = bound.reads, bound.writes
        platform.notes = bound.notes
        platform.require = bound.require
    return platform


def find_platform(document: WorkflowDocument) -> tuple[str, Factory]:
    """Return the word that a workflow uses for its platform, and the factory behind it.

    Raises:
        WorkflowError: no such platform.
        MissingDependencyError: it needs a package that is not installed.
    """
    name = document.get("platform", str)
    try:
        return name, find_factory("platforms", name, PlatformError)
    except PlatformError as error:
        raise document.error(str(error), "platform") from error


def platform_options(document: WorkflowDocument, name: str, factory: Factory) -> dict[str, Any]:
    """Return a platform's options of the workflow file.

    Raises:
        WorkflowError: they are no mapping, or the platform has no such option.
    """
    options = document.get("platforms", dict, {}).get(name) or {}
    if not isinstance(options, dict):
        raise document.error(
            f"platforms.{name}: {options!r} is not a mapping of options", "platforms", name
        )
    free = option_names(factory)
    for option in options:
        if option not in free:
            raise document.error(
                f"platform {name!r} has no option {option!r}; {alternatives(option, free)}",
                "platforms",
                name,
                option,
            )
    return options


def _pose_of(value: Any, document: WorkflowDocument, context: BuildContext) -> Any:
    """Return `policy:NAME` as that policy's default pose, joint to [rad]; else the value."""
    if not isinstance(value, str) or not value.startswith("policy:"):
        return value
    name = value.removeprefix("policy:")
    if name not in context.policies:
        raise document.error(
            f"{value!r}: no policy {name!r}; {alternatives(name, context.policies)}", "platforms"
        )
    contract = context.policies[name]
    return dict(zip(contract.joints, map(float, contract.default_joint_pos)))
