"""Autowiring: calls a block factory with the states that its parameters name.

A parameter annotated `Reads`, `Writes` or `Amends` gets the view of the state of its name (or of
another label, where the workflow renames it); `states`, `robot`, `period` and `context` get those
objects; all others are options of the YAML file.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from unicon_core.errors import StateError, UniconError, WorkflowError, alternatives
from unicon_core.flow.block import Access, Block, as_block
from unicon_core.robots import Robot
from unicon_core.states import States
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
    """

    states: States
    robot: Robot
    period: float
    policies: Mapping[str, Any] = field(default_factory=dict)
    relative_to: Path | None = None

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
    parameters, access = _signature(factory)
    arguments: dict[str, Any] = {}
    used: dict[str, list[str]] = {"reads": [], "writes": [], "amends": []}
    special = context.special()
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
    for parameter in rename:
        if parameter not in access:
            raise WorkflowError(
                f"block {name!r} has no state parameter {parameter!r}; "
                f"{alternatives(parameter, access)}",
                where,
            )
    free = _free(parameters, access, special)
    open_ended = any(p.kind is p.VAR_KEYWORD for p in parameters.values())
    for option, value in options.items():
        if option not in free and not open_ended:
            raise WorkflowError(
                f"block {name!r} has no option {option!r}; {alternatives(option, free)}", where
            )
        arguments[option] = value
    for parameter, declared in parameters.items():
        if parameter in arguments:
            continue
        if parameter in special and parameter not in access:
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
    block.role = block.role or getattr(factory, "role", "")
    return block


def option_names(factory: Factory) -> list[str]:
    """Return the names of a factory's options, without states and context."""
    parameters, access = _signature(factory)
    return sorted(_free(parameters, access, _SPECIAL))


def state_names(factory: Factory) -> dict[str, str]:
    """Return the states that a factory's parameters name: to `reads`, `writes` or `amends`."""
    return _signature(factory)[1]


_SPECIAL = dict.fromkeys(("states", "robot", "period", "relative_to", "context"))


def _free(
    parameters: Mapping[str, inspect.Parameter],
    access: Mapping[str, str],
    special: Mapping[str, Any],
) -> list[str]:
    return [
        name
        for name, parameter in parameters.items()
        if name not in access
        and name not in special
        and parameter.kind not in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL)
    ]


def _signature(factory: Factory) -> tuple[Mapping[str, inspect.Parameter], dict[str, str]]:
    parameters = inspect.signature(factory).parameters
    target = factory.__init__ if inspect.isclass(factory) else factory
    hints = get_type_hints(target, include_extras=True)
    access: dict[str, str] = {}
    for name in parameters:
        hint = hints.get(name)
        if get_origin(hint) is Annotated:
            for mark in get_args(hint)[1:]:
                if isinstance(mark, Access):
                    access[name] = mark.mode
    return parameters, access
