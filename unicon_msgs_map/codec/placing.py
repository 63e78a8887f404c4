"""Where the fields of a publish entry go in a message: states and constants, for encoders.

`constant` makes of YAML's text and numbers what the wire type takes.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

from unicon_base.errors import alternatives
from unicon_msgs_map.codec.binding import SINGLE_MAX, Bound, affine, limits, message_order
from unicon_msgs_map.errors import MapStateError, count_of
from unicon_msgs_map.layout.check import resolve
from unicon_msgs_map.layout.messages import Array, Primitive, String, Struct, TypeRef
from unicon_msgs_map.layout.template import (
    Leaf,
    Node,
    Place,
    expand,
    leaf_size,
    numeric_leaves,
    place,
)
from unicon_msgs_map.spec import FieldSpec


def place_state(root: Node, message: Struct, number: int, bound: Bound) -> Bound:
    """Place a state's elements; return them in message order.

    Args:
        root: what is placed so far.
        message: its type.
        number: of the field in the mapping entry.
        bound: the state, with elements in its own order.

    Raises:
        MessageTypeError: the path does not fit the type.
        MapStateError: size or type do not fit, or the place is taken.
    """
    field = bound.field
    kind = resolve(field, message, receive=False)
    elements = message_order(bound.elements, field, kind)
    leaves, sizes = _leaves(field, message, len(elements))
    if sum(sizes) != len(elements):
        raise MapStateError(
            f"{field.path} takes {count_of(sum(sizes))}, {field.source} has {len(elements)}; "
            f"select them, as in {field.source.name}[:{sum(sizes)}]",
            field.where,
        )
    rank = 0
    for leaf, size in zip(leaves, sizes):
        part = elements[rank : rank + size]
        place(root, leaf, _state_place(leaf.type, number, part, rank, bound), field)
        rank += size
    conversion = affine(field, len(elements), receive=False)
    return replace(bound, elements=elements, conversion=conversion)


def _leaves(field: FieldSpec, message: Struct, count: int | None) -> tuple[list[Leaf], list[int]]:
    """Return where a path leads to, and how many of our `count` elements go to each place."""
    places = expand(field, field.steps, Leaf((), message, message), count)
    leaves = [leaf for each in places for leaf in numeric_leaves(each, field)]
    if count is None:
        return leaves, []
    if len(places) == 1 and isinstance(places[0].type, Array) and places[0].type.length is None:
        return leaves, [count]
    return leaves, [leaf_size(leaf.type, field) for leaf in leaves]


def _state_place(
    kind: TypeRef, number: int, part: tuple[int, ...], rank: int, bound: Bound
) -> Place:
    field = bound.field
    if isinstance(kind, Struct):  # a Time or Duration
        if bound.is_float or bound.flat.dtype.kind == "b":
            raise field.state_error(
                f"{kind.name} takes integer nanoseconds, state {field.source.name!r} has dtype "
                f"{bound.flat.dtype}; use an int64 state"
            )
        return Place("time", number, part, rank)
    if isinstance(kind, String):
        if field.text is None:
            raise field.state_error(
                f"a string cannot hold state {field.source.name!r}; write "
                f"{{state: {field.source}, text: 8.2f}} for a number of fixed width, or "
                f"={field.source} for the word"
            )
        width = len(format(0.0 if bound.is_float else 0, field.text))
        if kind.bound and width > kind.bound:
            raise field.state_error(
                f"text {field.text!r} is {width} wide; the string takes {kind.bound}"
            )
        return Place("text", number, part, rank, width)
    if isinstance(kind, Array) and not isinstance(kind.item, Primitive):
        what = "strings" if isinstance(kind.item, String) else kind.item.name
        raise field.state_error(
            f"an array of {what} cannot hold state {field.source.name!r}; map the fields of its "
            f"elements, as in {field.path}[0], or give a $variable"
        )
    if isinstance(kind, Array) and kind.bound and len(part) > kind.bound:
        raise MapStateError(
            f"{field.path} takes at most {count_of(kind.bound)}, {field.source} has {len(part)}; "
            f"select them, as in {field.source.name}[:{kind.bound}]",
            field.where,
        )
    return Place("number", number, part, rank)


def place_constant(root: Node, message: Struct, field: FieldSpec, value: object) -> None:
    """Place a constant or the value of a variable, one or a list of them.

    Raises:
        MessageTypeError: the path does not fit the type.
        MapStateError: it does not fit, or the place is taken.
    """
    resolve(field, message, receive=False)
    if isinstance(value, str) or not isinstance(value, Sequence):
        for leaf in _leaves(field, message, None)[0]:
            _place_one(root, field, leaf, value)
        return
    items = list(value)
    leaves, sizes = _leaves(field, message, len(items))
    if sum(sizes) != len(items):
        raise MapStateError(
            f"{field.path} takes {sum(sizes)} values, {len(items)} are given", field.where
        )
    start = 0
    for leaf, size in zip(leaves, sizes):
        many = isinstance(leaf.type, Array)
        _place_one(root, field, leaf, items[start : start + size] if many else items[start])
        start += size


def _place_one(root: Node, field: FieldSpec, leaf: Leaf, value: object) -> None:
    kind, constants = leaf.type, leaf.owner.constants
    if isinstance(kind, Array):
        if isinstance(value, list):
            items = value
        elif kind.length is None:
            raise MapStateError(
                f"{field.path} is a sequence and takes a list, not {value!r}; write [{value}]",
                field.where,
            )
        else:
            items = [value] * kind.length
        if kind.bound and len(items) > kind.bound:
            raise MapStateError(
                f"{field.path} takes at most {count_of(kind.bound)}, {len(items)} are given",
                field.where,
            )
        parts = [constant(field, kind.item, item, constants) for item in items]
        place(root, leaf, parts, field)
        return
    if isinstance(kind, Struct):  # a Time or Duration, in nanoseconds
        if isinstance(value, bool) or not isinstance(value, int):
            raise field.state_error(f"{kind.name} takes integer nanoseconds, not {value!r}")
        sec, nanosec = divmod(value, 1_000_000_000)
        for name, number in (("sec", sec), ("nanosec", nanosec)):
            part = Leaf((*leaf.at, name), kind.fields[name], kind)
            place(root, part, constant(field, part.type, number, {}), field)
        return
    place(root, leaf, constant(field, kind, value, constants), field)


_FRAMES = ("frame_id", "child_frame_id")
_FRAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_./-]*")  # no leading slash since tf2
LONGEST_NUMBER = 40


def constant(
    field: FieldSpec, kind: TypeRef, value: object, constants: Mapping[str, object]
) -> object:
    """Return a constant as the wire type takes it.

    Args:
        field: the mapping's entry, for messages.
        kind: the wire type.
        value: text, number or boolean; text may be the name of a constant or a number.
        constants: named constants of the message that holds the field.

    Raises:
        MapStateError: it does not fit.
    """
    if isinstance(kind, String):
        if not isinstance(value, str):
            value = str(value)
        if kind.bound and len(value.encode()) > kind.bound:
            raise field.state_error(f"{value!r} is longer than the string's bound of {kind.bound}")
        if "\0" in value:
            raise field.state_error("a string cannot hold a NUL character")
        if field.steps[-1][0] in _FRAMES and value and not _FRAME.fullmatch(value):
            raise field.state_error(
                f"{value[:60]!r} is not a frame; write letters, digits and _ . / -, without a "
                "leading slash"
            )
        return value
    if not isinstance(kind, Primitive):
        raise field.state_error(
            f"{value!r} cannot fill a {getattr(kind, 'name', 'message array')}; map the fields of "
            "its elements"
        )
    number = constants.get(value, value) if isinstance(value, str) else value
    if isinstance(number, bytes) and len(number) == 1:
        number = number[0]
    if isinstance(number, str):
        try:
            number = _parse_number(number)
        except ValueError:
            named = alternatives(str(number), constants) if constants else "no constant is named"
            raise field.state_error(f"{number!r} is not {_one(kind)}; {named}") from None
    if not isinstance(number, (int, float)):
        raise field.state_error(f"{value!r} is not {_one(kind)}")
    if kind.name == "bool":
        return bool(number)
    if kind.code in "fd":
        if kind.code == "f" and SINGLE_MAX < abs(number) < math.inf:
            raise field.state_error(f"{value!r} is more than a float32")
        return float(number)
    low, high = limits(kind.dtype)
    if isinstance(number, float) and number.is_integer():
        number = int(number)
    if not isinstance(number, int) or not low <= number <= high:
        raise field.state_error(
            f"{value!r} is not {_one(kind)}; give an integer from {low} to {high}"
        )
    return int(number)


def _one(kind: Primitive) -> str:
    return f"{'an' if kind.name.startswith('i') else 'a'} {kind.name}"


def _parse_number(text: str) -> bool | int | float:
    if len(text) > LONGEST_NUMBER:
        raise ValueError("too long")
    if text in ("true", "false"):
        return text == "true"
    try:
        return int(text, 0)
    except ValueError:
        return float(text)
