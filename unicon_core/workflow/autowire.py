"""Autowiring: calls a block factory with the states that its parameters name.

A parameter annotated `Reads`, `Writes` or `Amends` gets the view of the state of its name (or of
another label, where the workflow renames it); one annotated with a `Bundle` gets the views of its
fields; `states`, `robot`, `period` and `context` get those objects; all others are options of the
YAML file. The JSON Schema of flows and platforms completes in an editor what is read here.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from unicon_base import (
    AnyDict,
    AnyMapping,
    MissingDependencyError,
    StateError,
    TextSink,
    UniconError,
    WorkflowError,
    alternatives,
)
from unicon_base.located_yaml import Where
from unicon_base.schema.records import described, option_hints, option_type, type_of
from unicon_base.schema.types import Mistakes, Type
from unicon_core.flow.block import Block, Bundle, Stage, as_block
from unicon_core.models.find import model_of
from unicon_core.platforms.kit.command import LastSent
from unicon_core.platforms.platform import Platform
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.workflow.registry import Factory, find_factory, known, product_of, states_in


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
        dry: no device may be opened.
        tell: takes what a block tells while it ticks, one line.
        driving: whether commands have left.
        sent: what has left last, or None where nothing is ever sent.
        paced: whether the clock paces ticks just now.
        networks: those in processes of their own; all mentions of a policy share one.
        lag: how much older what a block reads is when the robot gets what it writes, in [s]: a tick
            on another part than the robot, else 0.
        models: those that blocks compute with, by robot, file and use; all blocks share one.
        carried: it is the share of a member that another one carries, such as a hand: the platform
            simulates, and the IMU tells of, the one that carries it.
        scene: as the workflow says it.
        blocks: those that are built already.
        shadow: what stands beside a policy, as of `workflow.shadow.Shadow`, or None.

    A parameter `context` gets all of it, one of the names in `PARTS` that attribute.
    """

    states: States
    robot: Robot
    period: float
    policies: AnyMapping = field(default_factory=dict)
    relative_to: Path | None = None
    platform: Platform | None = None
    dry: bool = False
    tell: TextSink = print
    driving: Callable[[], bool] = lambda: True
    sent: LastSent | None = None
    paced: Callable[[], bool] = lambda: False
    networks: dict[tuple[str, str], Any] = field(default_factory=dict)
    lag: float = 0.0
    models: dict[tuple[Any, ...], Any] = field(default_factory=dict)
    carried: bool = False
    scene: AnyMapping = field(default_factory=dict)
    blocks: Sequence[Block] = ()
    shadow: Any = None

    def model(
        self, block: str, load: Callable[[Path], Any] | None = None, key: Iterable[Any] = ()
    ) -> Any:
        """Return the model that the platform simulates; of a robot, or of what it carries, its own.

        Blocks compute with an `MjData` of their own and leave the model as it is.

        Args:
            block: that asks, for the message.
            load: makes what is returned of the file; a `LoadedModel` unless given.
            key: what it is made for besides robot and file: of equal ones it is made once.

        Raises:
            ModelError: there is none, or it lacks a joint of the robot.
            MissingDependencyError: MuJoCo, which computes the kinematics, is not installed.
        """
        from unicon_core.models.load import load_model  # of workflows with such blocks alone

        path = model_of(None if self.carried else self.platform, self.robot)
        place = (self.robot.name, path, *key)
        if place not in self.models:
            try:
                made = load_model(path, self.robot, quiet=True) if load is None else load(path)
            except MissingDependencyError as error:
                raise MissingDependencyError(
                    f"block {block!r}", "mujoco", "pip install 'unicon_ros[sim]'"
                ) from error
            self.models[place] = made
        return self.models[place]


PARTS = ("states", "robot", "period", "relative_to")
"""Parts of the context that a parameter of that name gets."""


def autowire(
    factory: Factory,
    name: str,
    context: BuildContext,
    options: AnyMapping,
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

    def wrong(text: str, *_: str) -> WorkflowError:
        return WorkflowError(f"block {name!r}{text}", where)

    used: dict[str, list[str]] = {"reads": [], "writes": [], "amends": []}
    arguments = _states_of(factory, context, rename, wrong, used)
    named = state_names(factory)
    for parameter in rename:
        if parameter not in named:
            known = alternatives(parameter, named)
            raise wrong(f" has no state parameter {parameter!r}; {known}")
    arguments |= read_options(factory, options, wrong)
    free = option_names(factory)
    for parameter, declared in inspect.signature(factory).parameters.items():
        if parameter in arguments:
            continue
        if parameter in PARTS:
            arguments[parameter] = getattr(context, parameter)
        elif parameter == "context":
            arguments[parameter] = context
        elif declared.default is declared.empty and parameter in free:
            raise wrong(f" needs the option {parameter!r}; give it as {parameter}: VALUE")
    try:
        built = factory(**arguments)
    except (StateError, WorkflowError) as error:
        raise wrong(f": {error}") from error
    except UniconError:
        raise
    except (TypeError, ValueError) as error:
        raise wrong(f": {error}; correct its options") from error
    block = as_block(built, name=name, where=where)
    for mode, labels in used.items():
        setattr(block, mode, tuple(dict.fromkeys([*labels, *getattr(block, mode)])))
    if getattr(block.tick, "estimates", False) and context.platform is not None:
        told = [name for name in block.writes if name in context.platform.facts.writes]
        block.writes = tuple(name for name in block.writes if name not in told)
        block.amends = (*block.amends, *told)
    block.stage = block.stage or getattr(factory, "stage", None)
    return block


def read_options(
    factory: Factory, options: AnyMapping, wrong: Callable[..., UniconError]
) -> AnyDict:
    """Return options as the hints of a factory have them: each value read, nothing left to check.

    Args:
        factory: of a block, a platform or a face.
        options: of the workflow, or of the command line.
        wrong: makes the error of what follows the block's or platform's name, and of the option
            that is not there.

    Raises:
        UniconError: made by `wrong`: there is no such option, or a value is not what its hint says.
    """
    free = option_names(factory)
    parameters = inspect.signature(factory).parameters.values()
    if not any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters):
        for option in options:
            if option not in free:
                raise wrong(f" has no option {option!r}; {alternatives(option, free)}", option)
    mistakes, found = Mistakes(options), dict(options)
    for option, value in options.items():
        kind = option_type(factory, option)
        if kind is not None:
            found[option] = kind.read(value, (option,), mistakes)
    if mistakes.found:
        texts = [text for _, text in mistakes.found]
        if getattr(product_of(factory), "stage", None) is Stage.SAFETY:
            texts.append("to run without it leave it out of safety:")
        raise wrong(f": {'; '.join(texts)}")
    return found


def option_names(factory: Factory) -> list[str]:
    """Return the names of a factory's options, without states and context."""
    access, bundles = _annotated(factory)
    parameters = inspect.signature(factory).parameters
    taken = {*access, *bundles, *PARTS, "context", "scene"}
    silent = parameters.get("silent")
    if silent is not None and not isinstance(silent.default, str):
        taken.add("silent")  # of a platform that can be opened to receive only
    return sorted(
        name
        for name, parameter in parameters.items()
        if name not in taken
        and parameter.kind not in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL)
    )


def state_names(factory: Factory) -> dict[str, str]:
    """Return the states that a factory's parameters name: to `reads`, `writes` or `amends`."""
    access, bundles = _annotated(factory)
    for bundle in bundles.values():
        access.update(state_names(bundle))
    return access


def _states_of(
    factory: Factory,
    context: BuildContext,
    rename: Mapping[str, str],
    wrong: Callable[..., WorkflowError],
    used: Mapping[str, list[str]],
) -> AnyDict:
    """Return the arguments that are states or bundles of them; add the labels to `used`."""
    arguments: AnyDict = {}
    access, bundles = _annotated(factory)
    for parameter, mode in access.items():
        label = rename.get(parameter, parameter)
        if label not in context.states:
            raise wrong(
                f": no state {label!r}; {alternatives(label, context.states)}; "
                f"declare it under 'states:' or map it with 'states: {{{parameter}: LABEL}}'"
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
            raise wrong(
                f": {bundle.__name__}.{others[0]} is not a state; annotate it Reads, "
                "Writes or Amends, or make it a parameter of the block"
            )
        arguments[parameter] = bundle(**_states_of(bundle, context, rename, wrong, used))
    return arguments


def _annotated(factory: Factory) -> tuple[dict[str, str], dict[str, type[Bundle]]]:
    hints = option_hints(factory)
    return states_in({name: hints.get(name) for name in inspect.signature(factory).parameters})


Json = AnyDict

_OWN = {"pattern": r"^[\w.]+:\w+$", "type": "string", "description": "a factory of one's own"}
_SEVERAL = ("zip", "chain")
_WORDS = ("loop", "every", "when", "switch", "skills", "call")


class Flow(Type):
    """A graph: a block, or a word such as `chain` around others."""

    wanted = "a block, or {chain: [...]}"

    def json(self, definitions: Json) -> Json:
        """Return a reference to the schema of all flows."""
        if "Flow" not in definitions:
            definitions["Flow"] = flow = Json()
            here = {"$ref": "#/$defs/Flow"}
            blocks = {name: _block(name, definitions) for name in sorted(known("blocks"))}
            words: Json = {
                word: {"type": "array", "items": here, "minItems": 1} for word in _SEVERAL
            }
            words |= {word: {} for word in _WORDS}
            words |= {"deferred": here, "of": {"type": "string"}, "on": {"type": "string"}}
            words["policy"] = {"description": "the policy of that name, under `policies:`"}
            flow["anyOf"] = [
                {"enum": [*blocks, "policy", "skills"]},
                {
                    "type": "object",
                    "properties": blocks | words,
                    "patternProperties": {r"^[\w.]+:\w+$": {}},
                    "additionalProperties": False,
                    "minProperties": 1,
                },
                _OWN,
            ]
        return {"$ref": "#/$defs/Flow"}


class Platforms(Type):
    """Options by platform."""

    wanted = "a mapping of platforms to their options"

    def read(self, value: Any, where: Where, mistakes: Mistakes) -> Any:
        """Return the mapping; options are read by the builder, for the platforms that are used."""
        return type_of(Mapping[str, AnyMapping | None]).read(value, where, mistakes)

    def json(self, definitions: Json) -> Json:
        """Return the schema of `platforms:`."""
        options = {n: _options("platforms", n, definitions) for n in sorted(known("platforms"))}
        given = {
            name: {"anyOf": [each, _NULL]} for name, each in options.items() if each is not None
        }
        anything = {"type": ["object", "null"]}
        return {"type": "object", "properties": given, "additionalProperties": anything}


class PlatformName(Type):
    """A platform's name, or a mapping of members to names."""

    wanted = "NAME, or {MEMBER: NAME}"

    def json(self, definitions: Json) -> Json:
        """Return the schema of `platform:`."""
        members = {"type": "object", "additionalProperties": {"type": "string"}}
        return {"anyOf": [{"enum": sorted(known("platforms"))}, _OWN, members]}


FLOW, PLATFORMS, PLATFORM_NAME = Flow(), Platforms(), PlatformName()


def _block(name: str, definitions: Json) -> Json:
    options = _options("blocks", name, definitions)
    if options is None:  # what it needs is not installed
        return {}
    first = next(iter(options["properties"].values()), None)
    rest = [] if first is None else [{k: v for k, v in first.items() if k != "description"}]
    return {"description": options.pop("description", ""), "anyOf": [options, *rest, _NULL]}


_NULL = {"type": "null"}


def _options(kind: str, name: str, definitions: Json) -> Json | None:
    try:
        factory: Factory = find_factory(kind, name, UniconError)
    except UniconError:
        return None
    free, text = option_names(factory), inspect.getdoc(factory) or ""
    types = {name: option_type(factory, name) for name in free}
    texts, parameters = described(text), inspect.signature(factory).parameters
    schema: Json = {
        option: (made.json(definitions) if (made := types[option]) is not None else {})
        | ({"description": texts[option]} if option in texts else {})
        for option in parameters
        if option in free
    }
    extra = any(each.kind is each.VAR_KEYWORD for each in parameters.values())
    if kind == "blocks":
        schema |= {"name": {"type": "string"}, "states": {"type": "object"}}
    about = text.partition("\n")[0]
    return {
        "type": "object",
        "properties": schema,
        "additionalProperties": extra,
        "description": about,
    }
