"""What a subscription writes or requires, per field: resolved once when a decoder is built."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from unicon_msgs_map.codec.binding import (
    Arrays,
    Bound,
    Names,
    Variables,
    affine,
    bind_state,
    bind_variable,
    message_order,
)
from unicon_msgs_map.codec.encoder import constant
from unicon_msgs_map.errors import MapStateError, count_of
from unicon_msgs_map.layout.messages import Array, Primitive, String, Struct, TypeRef
from unicon_msgs_map.layout.template import Leaf, leaf_size, numeric_leaves, resolve
from unicon_msgs_map.spec import FieldSpec, SubscribeSpec

Listed = dict[int, tuple[str, ...]]  # element names by the number of the field that carries them


@dataclass(frozen=True)
class Target:
    """One field of a subscription.

    Attributes:
        number: of the field in the mapping entry.
        field: the mapping's entry.
        bound: the state it writes, elements in message order; None for names and constants.
        is_time: whether the field is a Time or Duration.
        by: number of the field whose texts order the elements; None goes by position.
        order: our element names as the message would write them, where `by` is set.
        required: constant that the message must carry; None where a state is written.
    """

    number: int
    field: FieldSpec
    bound: Bound | None = None
    is_time: bool = False
    by: int | None = None
    order: tuple[str, ...] = ()
    required: object = None


def bind_targets(
    spec: SubscribeSpec, message: Struct, arrays: Arrays, names: Names, variables: Variables
) -> list[Target]:
    """Resolve every field of a subscription.

    Raises:
        MapStateError: a state, variable, size or dtype does not fit.
    """
    listed = {
        number: _texts(field, bind_variable(field, variables))
        for number, field in enumerate(spec.fields)
        if field.source.kind == "variable"
    }
    targets: list[Target] = []
    written: dict[tuple[str, int], str] = {}
    for number, field in enumerate(spec.fields):
        kind = resolve(field, message, receive=True)
        if field.source.kind == "variable":
            targets.append(Target(number, field))
        elif field.source.kind == "const":
            targets.append(_required(number, field, kind))
        else:
            bound = bind_state(field, arrays, names)
            if not bound.flat.flags.writeable:
                raise field.state_error(
                    f"state {field.source.name!r} is read-only; a subscription needs a writable "
                    "array"
                )
            target = _target(number, kind, message, bound, listed, spec)
            assert target.bound is not None
            if spec.on_timeout == "unset" and not (target.is_time or bound.is_float):
                raise field.state_error(
                    f"on_timeout: unset makes a state NaN, and {field.source.name!r} is "
                    f"{bound.flat.dtype}; say zero or hold"
                )
            for element in target.bound.elements:
                key = (field.source.name, element)
                if key in written:
                    raise field.state_error(
                        f"{field.source.name}[{element}] is already written by {written[key]}; "
                        "drop one of the two"
                    )
                written[key] = field.path
            targets.append(target)
    return targets


def _target(
    number: int, kind: TypeRef, message: Struct, bound: Bound, listed: Listed, spec: SubscribeSpec
) -> Target:
    field, count = bound.field, len(bound.elements)
    if isinstance(kind, String) or (isinstance(kind, Array) and isinstance(kind.item, String)):
        raise field.state_error(
            f"text cannot be read into state {field.source.name!r}; write ={field.source} to "
            "require the word"
        )
    if isinstance(kind, Array) and not isinstance(kind.item, Primitive):
        raise field.state_error(
            f"an array of {kind.item.name} cannot fill state "  # type: ignore[union-attr]
            f"{field.source.name!r}; map the fields of its elements, as in {field.path}[0]"
        )
    is_time = isinstance(kind, Struct) and kind.is_time
    if is_time and bound.flat.dtype.kind not in "iu":
        raise field.state_error(
            f"a time is integer nanoseconds, state {field.source.name!r} has dtype "
            f"{bound.flat.dtype}; use an int64 state"
        )
    field = _close_ranges(field, message, count)
    fixed = _fixed_count(field, message)
    if fixed is not None and fixed != count:
        raise MapStateError(
            f"{field.path} has {count_of(fixed)}, {field.source} has {count}; "
            f"select them, as in {field.source.name}[:{fixed}]",
            field.where,
        )
    elements = message_order(bound.elements, field, kind)
    by = _by(field, fixed, spec, listed)
    order: tuple[str, ...] = ()
    if by is not None:
        order = listed[by] if len(listed[by]) == count else (bound.names or ())
        if len(order) != count:
            raise field.state_error(
                f"{field.source} has {count_of(count)}, ${spec.fields[by].source.name} names "
                f"{len(listed[by])}; give a state of that size, element names for it, or by: none"
            )
    conversion = affine(field, count, receive=True)
    bound = replace(bound, field=field, elements=elements, conversion=conversion)
    return Target(number, field, bound, is_time, by, order)


def _by(field: FieldSpec, fixed: int | None, spec: SubscribeSpec, listed: Listed) -> int | None:
    if field.by == "none":
        return None
    if field.by is not None:
        return next(n for n in listed if spec.fields[n].path == field.by)
    if fixed is not None or not listed:
        return None
    if len(listed) > 1:
        paths = ", ".join(spec.fields[n].path for n in listed)
        raise field.state_error(
            f"several fields carry names ({paths}); say which one orders it, as in "
            "{state: …, by: …}"
        )
    return next(iter(listed))


def _close_ranges(field: FieldSpec, message: Struct, count: int) -> FieldSpec:
    """End an open range over a fixed array where the state ends; sequences stay open."""
    steps = list(field.steps)
    owner: TypeRef = message
    for number, (name, selector) in enumerate(steps):
        assert isinstance(owner, Struct)
        owner = owner.fields[name]
        if isinstance(owner, Array) and selector is not None:
            if isinstance(selector, tuple) and selector[1] is None and owner.length is not None:
                steps[number] = (name, (selector[0], selector[0] + 1))
                each = _fixed_count(replace(field, steps=tuple(steps)), message) or 1
                stop = selector[0] + count // each
                if stop > owner.length or stop == selector[0]:
                    raise MapStateError(
                        f"{field.path} has {count_of((owner.length - selector[0]) * each)}, "
                        f"{field.source} has {count}; select fewer, as in {field.source.name}[:3]",
                        field.where,
                    )
                steps[number] = (name, (selector[0], stop))
            owner = owner.item
    return replace(field, steps=tuple(steps))


def _fixed_count(field: FieldSpec, message: Struct) -> int | None:
    """Return the number of elements at a path, None where the message decides it."""
    total = 1
    owner: TypeRef = message
    for name, selector in field.steps:
        assert isinstance(owner, Struct)
        owner = owner.fields[name]
        if isinstance(owner, Array):
            if selector is None:
                return None if owner.length is None else total * owner.length
            if isinstance(selector, tuple):
                stop = selector[1] if selector[1] is not None else owner.length
                if stop is None:
                    return None
                total *= stop - selector[0]
            owner = owner.item
    flat = numeric_leaves(Leaf((), owner, message), field)
    return total * sum(leaf_size(leaf.type, field) for leaf in flat)


def _required(number: int, field: FieldSpec, kind: TypeRef) -> Target:
    if not isinstance(kind, Primitive | String) or any(
        isinstance(selector, tuple) for _, selector in field.steps
    ):
        raise field.state_error(
            "a subscription can require the value of one number or text only; name it, as in "
            "header.frame_id"
        )
    return Target(number, field, required=constant(field, kind, field.source.value, {}))


def _texts(field: FieldSpec, value: object) -> tuple[str, ...]:
    if isinstance(value, str) or not isinstance(value, Sequence):
        raise field.state_error(f"${field.source.name} must be a list of names, not {value!r}")
    texts = tuple(str(item) for item in value)
    if len(set(texts)) != len(texts):
        twice = next(t for t in texts if texts.count(t) > 1)
        raise field.state_error(f"${field.source.name} holds {twice!r} twice; names must differ")
    return texts
