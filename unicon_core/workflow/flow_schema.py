"""JSON Schema of flows, blocks and platforms: their words, with the options of their factories.

Reading is the builder's: an editor completes by these what `flow_yaml` and `autowire` refuse.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any

from unicon_base.errors import UniconError
from unicon_base.located_yaml import Where
from unicon_base.schema.records import described, option_type, type_of
from unicon_base.schema.types import Mistakes, Type
from unicon_core.workflow.autowire import option_names
from unicon_core.workflow.registry import Factory, find_factory, known

Json = dict[str, Any]

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
        return type_of(Mapping[str, Mapping[str, Any] | None]).read(value, where, mistakes)

    def json(self, definitions: Json) -> Json:
        """Return the schema of `platforms:`."""
        options = {n: _options("platforms", n, definitions) for n in sorted(known("platforms"))}
        given = {
            name: {"anyOf": [each, {"type": "null"}]}
            for name, each in options.items()
            if each is not None
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
