"""Autowiring: calls a block factory with the states that its parameters name.

A parameter annotated `Reads`, `Writes` or `Amends` gets the view of the state of its name (or of
another label, where the workflow renames it); one annotated with a `Bundle` gets the views of its
fields; `states`, `robot`, `period` and `context` get those objects; all others are options of the
YAML file.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from unicon_core.errors import StateError, UniconError, WorkflowError, alternatives
from unicon_core.flow.block import Access, Block, Bundle, as_block
from unicon_core.platforms.platform import Platform
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.workflow.option_types import wrong_option
from unicon_core.workflow.registry import Factory

__all__ = ["BuildContext", "autowire", "option_names", "state_names"]


@dataclass
class BuildContext:
    """What a factory may ask for.

    Attributes:
        states: all states of the workflow.
        robot: the robot.
        period: tick period in [s].
        policies: name to loaded contract.
        relative_to: folder of the workflow file, for relative paths; None if there is none.
        platform: of the workflow, once it is built.
    """

    states: States
    robot: Robot
    period: float
    policies: Mapping[str, Any] = field(default_factory=dict)
    relative_to: Path | None = None
    platform: Platform | None = None

    def special(self) -> dict[str, Any]:
        """Return the parameter names that mean parts of the context."""
        return {
            "states": self.states,
            "robot": self.robot,
            "period": self.period,
            "relative_to": self.relative_to,
            "context": self,
        }


def autowire(
    factory: Factory,
    name: str,
    context: BuildContext,
    options: Mapping[str, Any],
    rename: Mapping[str, str] | None = None,
    where: str = "",
) -> Block:
    """Build a block.

    Args:
        factory: function or class; what it returns is the tick function.
        name: the block's label.
        context: states and the rest.
        options: keyword options of the workflow.
        rename: parameter name to state label.
        where: `file:line` for messages.

    Raises:
        WorkflowError: an unknown or missing option, or a state that does not exist.
    """
    rename = rename or {}
    used: dict[str, list[str]] = {"reads": [], "writes": [], "amends": []}
    arguments = _states_of(factory, name, context, rename, where, used)
    named = state_names(factory)
    for parameter in rename:
        if parameter not in named:
            raise WorkflowError(
                f"block {name!r} has no state parameter {parameter!r}; "
                f"{alternatives(parameter, named)}",
                where,
            )
    parameters = inspect.signature(factory).parameters
    special = context.special()
    free = option_names(factory)
    open_ended = any(p.kind is p.VAR_KEYWORD for p in parameters.values())
    for option, value in options.items():
        if option not in free and not open_ended:
            raise WorkflowError(
                f"block {name!r} has no option {option!r}; {alternatives(option, free)}", where
            )
        arguments[option] = value
    wrong = wrong_option(factory, options)
    if wrong:
        raise WorkflowError(f"block {name!r}: {wrong}", where)
    for parameter, declared in parameters.items():
        if parameter in arguments:
            continue
        if parameter in special:
            arguments[parameter] = special[parameter]
        elif declared.default is declared.empty and parameter in free:
            raise WorkflowError(
                f"block {name!r} needs the option {parameter!r}; give it as {parameter}: VALUE",
                where,
            )
    try:
        built = factory(**arguments)
    except (StateError, WorkflowError) as error:
        raise WorkflowError(f"block {name!r}: {error}", where) from error
    except UniconError:
        raise
    except (TypeError, ValueError) as error:
        raise WorkflowError(f"block {name!r}: {error}; correct its options", where) from error
    block = as_block(built, name=name, where=where)
    block.reads = tuple(dict.fromkeys([*used["reads"], *block.reads]))
    block.writes = tuple(dict.fromkeys([*used["writes"], *block.writes]))
    block.amends = tuple(dict.fromkeys([*used["amends"], *block.amends]))
    block.stage = block.stage or getattr(factory, "stage", None)
    return block


def option_names(factory: Factory) -> list[str]:
    """Return the names of a factory's options, without states and context."""
    access, bundles = _annotated(factory)
    taken = {*access, *bundles, *_SPECIAL}
    return sorted(
        name
        for name, parameter in inspect.signature(factory).parameters.items()
        if name not in taken
        and parameter.kind not in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL)
    )


def state_names(factory: Factory) -> dict[str, str]:
    """Return the states that a factory's parameters name: to `reads`, `writes` or `amends`."""
    access, bundles = _annotated(factory)
    for bundle in bundles.values():
        access.update(state_names(bundle))
    return access


_SPECIAL = ("states", "robot", "period", "relative_to", "context", "scene")


def _states_of(
    factory: Factory,
    name: str,
    context: BuildContext,
    rename: Mapping[str, str],
    where: str,
    used: Mapping[str, list[str]],
) -> dict[str, Any]:
    """Return the arguments that are states or bundles of them; add the labels to `used`."""
    arguments: dict[str, Any] = {}
    access, bundles = _annotated(factory)
    for parameter, mode in access.items():
        label = rename.get(parameter, parameter)
        if label not in context.states:
            raise WorkflowError(
                f"block {name!r}: no state {label!r}; {alternatives(label, context.states)}; "
                f"declare it under 'states:' or map it with 'states: {{{parameter}: LABEL}}'",
                where,
            )
        view = context.states[label]
        if mode == "reads":
            view = view.view()
            view.flags.writeable = False
        arguments[parameter] = view
        used[mode].append(label)
    for parameter, bundle in bundles.items():
        others = option_names(bundle)
        if others:
            raise WorkflowError(
                f"block {name!r}: {bundle.__name__}.{others[0]} is no state; annotate it Reads, "
                "Writes or Amends, or make it a parameter of the block",
                where,
            )
        arguments[parameter] = bundle(**_states_of(bundle, name, context, rename, where, used))
    return arguments


def _annotated(factory: Factory) -> tuple[dict[str, str], dict[str, type[Bundle]]]:
    """Return the parameters that are states, with their mode, and those that are bundles."""
    target = factory.__init__ if inspect.isclass(factory) else factory
    hints = get_type_hints(target, include_extras=True)
    access: dict[str, str] = {}
    bundles: dict[str, type[Bundle]] = {}
    for name in inspect.signature(factory).parameters:
        hint = hints.get(name)
        origin = get_origin(hint)
        if origin is None and inspect.isclass(hint) and issubclass(hint, Bundle):
            bundles[name] = hint
        if origin is Annotated:
            for mark in get_args(hint)[1:]:
                if isinstance(mark, Access):
                    access[name] = mark.mode
    return access, bundles
