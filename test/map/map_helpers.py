"""Shared by the tests of the message map: specs in one line, message values, random types."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st

from unicon_msgs_map import Messages, PublishSpec, SubscribeSpec
from unicon_msgs_map.layout.messages import (
    Array,
    Primitive,
    String,
    Struct,
    TypeRef,
    shared_messages,
)
from unicon_msgs_map.layout.paths import parse_path, parse_reference
from unicon_msgs_map.spec import FieldSpec

MAPS = Path(__file__).resolve().parents[2] / "config" / "maps"
JAZZY = shared_messages()
NAMES = ("hip", "thigh", "calf", "ankle", "waist", "neck")


def field_spec(path: str, value: object, **options: Any) -> FieldSpec:
    """Return a field from a path and what stands on our side."""
    return FieldSpec(path, parse_path(path), parse_reference(value), **options)


def fields(mapping: dict[str, object]) -> tuple[FieldSpec, ...]:
    """Return fields from a mapping; a dict value is `{state: …, option: …}`."""
    found = []
    for path, value in mapping.items():
        if isinstance(value, dict):
            options = dict(value)
            found.append(field_spec(path, options.pop("state"), **options))
        else:
            found.append(field_spec(path, value))
    return tuple(found)


def publish(kind: str, mapping: dict[str, object], messages: Messages = JAZZY) -> PublishSpec:
    """Return a publish entry."""
    return PublishSpec("topic", kind, fields(mapping), messages)


def subscribe(
    kind: str, mapping: dict[str, object], messages: Messages = JAZZY, **options: Any
) -> SubscribeSpec:
    """Return a subscribe entry."""
    return SubscribeSpec("topic", kind, fields(mapping), messages, **options)


def zero_message(kind: str, messages: Messages = JAZZY) -> Any:
    """Return a rosbags message object with zero, empty and false everywhere."""
    return _zero(messages.struct(kind), messages)


def _zero(kind: TypeRef, messages: Messages) -> Any:
    if isinstance(kind, Primitive):
        return False if kind.code == "?" else 0.0 if kind.code in "fd" else 0
    if isinstance(kind, String):
        return ""
    if isinstance(kind, Array):
        count = kind.length or 0
        if isinstance(kind.item, Primitive):
            return np.zeros(count, wire_dtype(kind.item))
        return [_zero(kind.item, messages) for _ in range(count)]
    values = [_zero(member, messages) for member in kind.fields.values()]
    return messages.store.types[kind.name](*values)


def wire_dtype(kind: Primitive) -> np.dtype[Any]:
    """Return the dtype that rosbags wants for an array."""
    return np.dtype({"?": "bool", "B": "u1"}.get(kind.code, kind.dtype))


def serialize(message: Any, messages: Messages = JAZZY, *, little: bool = True) -> bytes:
    """Return rosbags' bytes of a message: the slow reference."""
    return bytes(messages.store.serialize_cdr(message, message.__msgtype__, little_endian=little))


def get(message: Any, path: Sequence[str | int]) -> Any:
    """Return what a message holds at a place."""
    for step in path:
        message = message[step] if isinstance(step, int) else getattr(message, step)
    return message


# Random message types -----------------------------------------------------------------------------

_NUMBERS = [
    "bool", "byte", "char", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64",
    "uint64", "float32", "float64",
]  # fmt: skip
_counter = itertools.count()
REFERENCE = Messages("jazzy")


@dataclass
class RandomType:
    """A random message type and its definition."""

    name: str
    text: str
    parts: list[RandomType] = field(default_factory=list)

    def register(self, messages: Messages) -> str:
        """Add it and its parts to a store; return the full name."""
        for part in self.parts:
            part.register(messages)
        full = f"reference_msgs/msg/{self.name}"
        if full not in messages.store.fielddefs:
            messages.register({full: self.text})
        return full


@st.composite
def random_types(draw: st.DrawFn, depth: int = 2) -> RandomType:
    """Draw a message type of numbers, strings, arrays, sequences and other such messages."""
    parts: list[RandomType] = []
    lines = []
    for number in range(draw(st.integers(1, 5))):
        choices = [st.sampled_from(_NUMBERS), st.sampled_from(["string", "string<=6"])]
        if depth:
            choices.append(random_types(depth=depth - 1))
        choices.append(st.sampled_from(["builtin_interfaces/Time", "geometry_msgs/Vector3"]))
        item = draw(st.one_of(choices))
        if isinstance(item, RandomType):
            parts.append(item)
            item = item.name
        suffix = draw(st.sampled_from(["", "", "[]", "[3]", "[<=4]"]))
        lines.append(f"{item}{suffix} f{number}")
    return RandomType(f"T{next(_counter)}", "\n".join(lines) + "\n", parts)


def values(kind: TypeRef, messages: Messages) -> st.SearchStrategy[Any]:
    """Return a strategy for rosbags values of a type."""
    if isinstance(kind, Primitive):
        return number_values(kind)
    if isinstance(kind, String):
        text = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=5)
        return text.filter(lambda t: not kind.bound or len(t.encode()) <= kind.bound)
    if isinstance(kind, Array):
        low, high = (kind.length, kind.length) if kind.length else (0, kind.bound or 12)
        lists = st.lists(values(kind.item, messages), min_size=low, max_size=high)
        if isinstance(kind.item, Primitive):
            dtype = wire_dtype(kind.item)
            return lists.map(lambda items: np.array(items, dtype))
        return lists
    members = [values(member, messages) for member in kind.fields.values()]
    make = messages.store.types[kind.name]
    return st.tuples(*members).map(lambda items: make(*items))


def number_values(kind: Primitive) -> st.SearchStrategy[Any]:
    """Return numbers that float32 holds exactly, so that every state dtype may carry them."""
    if kind.code == "?":
        return st.booleans()
    if kind.code in "fd":
        return st.floats(width=32, allow_nan=False)
    if kind.name == "byte":
        return st.integers(0, 127)  # rosbags reads octets as signed
    info = np.iinfo(np.dtype(kind.dtype))
    return st.integers(int(info.min), int(info.max))


@dataclass(frozen=True)
class FlatLeaf:
    """A leaf of a message value: where it stands, and its type."""

    at: tuple[str | int, ...]
    kind: TypeRef

    @property
    def path(self) -> str:
        """The place as a mapping writes it."""
        text = ""
        for step in self.at:
            text += f"[{step}]" if isinstance(step, int) else f".{step}" if text else step
        return text


def leaves(kind: TypeRef, value: Any, at: tuple[str | int, ...] = ()) -> Iterator[FlatLeaf]:
    """Yield numbers, strings, and whole arrays of either, of a message value."""
    if isinstance(kind, Struct):
        for name, member in kind.fields.items():
            yield from leaves(member, getattr(value, name), (*at, name))
    elif isinstance(kind, Array) and isinstance(kind.item, Struct) and len(value):
        for index, item in enumerate(value):
            yield from leaves(kind.item, item, (*at, index))
    else:
        yield FlatLeaf(at, kind)
