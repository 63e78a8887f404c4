"""Where the fields of a publish entry go in a message: states and constants, for encoders."""

from __future__ import annotations

from collections.abc import Sequence

from unicon_msgs_map.codec.binding import Bound, quaternions
from unicon_msgs_map.codec.constants import constant, owner_constants
from unicon_msgs_map.errors import MapStateError, count_of
from unicon_msgs_map.layout.messages import QUATERNION, Array, Primitive, String, Struct, TypeRef
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

__all__ = ["place_constant", "place_state"]


def place_state(root: Node, message: Struct, number: int, field: FieldSpec, bound: Bound) -> Bound:
    """Place a state's elements; return them in message order.

    Args:
        root: what is placed so far.
        message: its type.
        number: of the field in the mapping entry.
        field: the mapping's entry.
        bound: the state, with elements in its own order.

    Raises:
        MapStateError: size or type do not fit, or the place is taken.
    """
    elements = bound.elements
    leaves = expand(field, message, len(elements))
    if len(leaves) == 1 and isinstance(leaves[0].type, Array) and leaves[0].type.length is None:
        kind = leaves[0].type
        _check_sequence(field, kind, len(elements))
        if field.quat == "xyzw_from_wxyz":
            elements = quaternions(elements, field)
        place(root, leaves[0], Place("number", number, elements, 0), field)
        return Bound(field, bound.flat, elements, bound.names)
    if any(_is_quaternion(leaf.type) for leaf in leaves) and field.quat is None:
        if not all(_is_quaternion(leaf.type) for leaf in leaves):  # pragma: no cover - one type
            raise MapStateError(f"{field.path}: mixes quaternions and others", field.where)
        elements = quaternions(elements, field)
    elif field.quat == "xyzw_from_wxyz":
        elements = quaternions(elements, field)
    flat = [one for leaf in leaves for one in numeric_leaves(leaf, field)]
    sizes = [leaf_size(leaf.type, field) for leaf in flat]
    if sum(sizes) != len(elements):
        raise MapStateError(
            f"{field.path} takes {count_of(sum(sizes))}, {field.source} has {len(elements)}; "
            f"select them, as in {field.source.name}[:{sum(sizes)}]",
            field.where,
        )
    rank = 0
    for leaf, size in zip(flat, sizes):
        part = elements[rank : rank + size]
        place(root, leaf, _state_place(field, leaf.type, number, part, rank, bound), field)
        rank += size
    return Bound(field, bound.flat, elements, bound.names)


def _state_place(
    field: FieldSpec,
    kind: TypeRef,
    number: int,
    part: tuple[int, ...],
    rank: int,
    bound: Bound,
) -> Place:
    if isinstance(kind, Struct):  # a Time or Duration
        if bound.is_float or bound.flat.dtype.kind == "b":
            raise MapStateError(
                f"{field.path}: {kind.name} takes integer nanoseconds, state "
                f"{field.source.name!r} has dtype {bound.flat.dtype}; use an int64 state",
                field.where,
            )
        return Place("time", number, part, rank)
    if isinstance(kind, String):
        if field.text is None:
            raise MapStateError(
                f"{field.path}: a string cannot hold state {field.source.name!r}; write "
                f"{{state: {field.source}, text: 8.2f}} for a number of fixed width, "
                f"or ={field.source} for the word",
                field.where,
            )
        width = len(format(0.0 if bound.is_float else 0, field.text))
        if kind.bound and width > kind.bound:
            raise MapStateError(
                f"{field.path}: text {field.text!r} is {width} wide; the string takes {kind.bound}",
                field.where,
            )
        return Place("text", number, part, rank, width)
    if isinstance(kind, Array):
        _check_sequence(field, kind, len(part))
    return Place("number", number, part, rank)


def _check_sequence(field: FieldSpec, kind: Array, count: int) -> None:
    if not isinstance(kind.item, Primitive):
        what = "strings" if isinstance(kind.item, String) else kind.item.name
        raise MapStateError(
            f"{field.path}: an array of {what} cannot hold state {field.source.name!r}; map the "
            f"fields of its elements, as in {field.path}[0], or give a $variable",
            field.where,
        )
    if kind.bound and count > kind.bound:
        raise MapStateError(
            f"{field.path} takes at most {count_of(kind.bound)}, {field.source} has {count}; "
            f"select them, as in {field.source.name}[:{kind.bound}]",
            field.where,
        )


def _is_quaternion(kind: TypeRef) -> bool:
    return isinstance(kind, Struct) and kind.name == QUATERNION


def place_constant(root: Node, message: Struct, field: FieldSpec, value: object) -> None:
    """Place a constant or the value of a variable, one or a list of them.

    Raises:
        MapStateError: it does not fit, or the place is taken.
    """
    if isinstance(value, str) or not isinstance(value, Sequence):
        leaves = expand(field, message, None)
        for leaf in leaves:
            for one in numeric_leaves(leaf, field):
                _place_one(root, message, field, one, value)
        return
    items = list(value)
    leaves = expand(field, message, len(items))
    if len(leaves) == 1 and isinstance(leaves[0].type, Array) and leaves[0].type.length is None:
        kind = leaves[0].type
        if kind.bound and len(items) > kind.bound:
            raise MapStateError(
                f"{field.path} takes at most {count_of(kind.bound)}, {len(items)} are given",
                field.where,
            )
        constants = message.constants
        place(
            root,
            leaves[0],
            [constant(field, kind.item, item, constants) for item in items],
            field,
        )
        return
    flat = [one for leaf in leaves for one in numeric_leaves(leaf, field)]
    total = sum(leaf_size(leaf.type, field) for leaf in flat)
    if total != len(items):
        raise MapStateError(
            f"{field.path} takes {total} values, {len(items)} are given", field.where
        )
    start = 0
    for leaf in flat:
        size = leaf_size(leaf.type, field)
        part: object = items[start : start + size] if isinstance(leaf.type, Array) else items[start]
        _place_one(root, message, field, leaf, part)
        start += size


def _place_one(root: Node, message: Struct, field: FieldSpec, leaf: Leaf, value: object) -> None:
    kind, constants = leaf.type, owner_constants(message, leaf)
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
        parts = [constant(field, kind.item, item, constants) for item in items]
        place(root, leaf, parts, field)
        return
    if isinstance(kind, Struct):  # a Time or Duration, in nanoseconds
        if isinstance(value, bool) or not isinstance(value, int):
            raise MapStateError(
                f"{field.path}: {kind.name} takes integer nanoseconds, not {value!r}", field.where
            )
        sec, nanosec = divmod(value, 1_000_000_000)
        for name, number in (("sec", sec), ("nanosec", nanosec)):
            member = kind.field(name)
            assert member is not None
            place(
                root,
                Leaf((*leaf.at, name), member.type),
                constant(field, member.type, number, {}),
                field,
            )
        return
    place(root, leaf, constant(field, kind, value, constants), field)
