"""Encoders: state arrays in, the bytes of one ROS message out; for bridges and recorders.

Built once per topic against arrays; then `encode()` takes no argument. The function is generated
(read it in `Encoder.source`): numbers that stand alone go through one `struct` pack, arrays are
cast-copied into NumPy views of a template, and arrays at even distances, such as joint_pos,
joint_vel and joint_effort in one state buffer, share a single strided copy.
This is `joint_states` of the default map, whose constants stand in `buffer`:

    def encode():
        # 428 bytes
        v_stamp_ns_0 = in_stamp_ns[0]
        v_stamp_ns_0_sec, v_stamp_ns_0_nanosec = divmod(v_stamp_ns_0, 1000000000)
        pack0(buffer, 4, v_stamp_ns_0_sec & 0xffffffff, v_stamp_ns_0_nanosec)
        into0[...] = from0  # joint_pos, joint_vel, joint_effort
        return bytes(buffer)
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from unicon_base import alternatives
from unicon_base.generated import define
from unicon_msgs_map.codec.binding import (
    SINGLE_MAX,
    Arrays,
    Bound,
    Names,
    Variables,
    affine,
    bind_state,
    bind_variable,
    limits,
    message_order,
    unitree_crc,
)
from unicon_msgs_map.codec.packs import Copy, Packs, as_copy, copy_lines
from unicon_msgs_map.errors import MapStateError, count_of
from unicon_msgs_map.layout.messages import Array, Primitive, String, Struct, TypeRef
from unicon_msgs_map.layout.template import (
    Leaf,
    Node,
    Place,
    Slot,
    Template,
    expand,
    leaf_size,
    numeric_leaves,
    place,
    resolve,
)
from unicon_msgs_map.spec import FieldSpec, PublishSpec


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
    if not isinstance(number, int | float):
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


def generate(
    template: Template, bounds: Mapping[int, Bound], checksum: Callable[[], int] | None = None
) -> tuple[Callable[[], bytes], str]:
    """Return the encode function and its source.

    Args:
        template: bytes and slots.
        bounds: state per field number.
        checksum: computes the last four bytes from the others, where the message has one.
    """
    copies: list[Copy] = []
    scalars: list[Slot] = []
    fields: dict[tuple[int, str], list[Slot]] = {}
    for slot in template.slots:
        kind = slot.primitive.name if slot.primitive else slot.kind
        fields.setdefault((slot.source, kind), []).append(slot)
    for (number, _), slots in fields.items():
        found = as_copy(slots, bounds[number])
        if found is None:
            scalars += slots
        else:
            copies.append(found)
    writer = Packs(template, bounds)
    body = writer.loads(scalars)
    if copies or checksum:
        body += writer.packs_into(scalars)
        lines, names = copy_lines(copies, template.data)
        writer.space |= names
        body += lines
        if checksum:
            writer.space |= {"checksum": checksum, "sign": struct.Struct("<I").pack_into}
            body.append(f"sign(buffer, {len(template.data) - 4}, checksum())")
        body.append("return bytes(buffer)")
    else:
        body.append(f"return {writer.pack(scalars)}")
    head = ["def encode():", f"    # {len(template.data)} bytes"]
    source = "\n".join(head + ["    " + line for line in body]) + "\n"
    encode: Callable[[], bytes] = define(source, writer.space, "<encode>")["encode"]
    return encode, source


@dataclass(eq=False, slots=True)
class Encoder:
    """Bytes of one message type from state arrays; make it with `Encoder.build`.

    Attributes:
        spec: the mapping entry.
        encode: returns the message as bytes: little-endian CDR behind its 4-byte header. Raises
            nothing: integers saturate, NaN becomes 0 in an integer field, and a finite number
            that float32 cannot hold becomes an infinity.
        source: the generated Python.
        size: length of every message, [B].
    """

    spec: PublishSpec
    encode: Callable[[], bytes]
    source: str
    size: int

    @classmethod
    def build(
        cls,
        spec: PublishSpec,
        arrays: Arrays,
        names: Names | None = None,
        variables: Variables | None = None,
    ) -> Encoder:
        """Compile a mapping entry against arrays, which are read in place from then on.

        Args:
            spec: topic, type and fields.
            arrays: state arrays by name, any shape; elements count in C order. `stamp_ns` and
                other times are integers in [ns].
            names: element names per state, for references such as `joint_pos[FR_hip_joint]`.
            variables: values of `$name`: text, numbers, or lists of them.

        Raises:
            MapStateError: a state, variable, size or dtype does not fit.
            MessageTypeError: the type or a path in it is unknown.
        """
        message = spec.messages.struct(spec.type)
        root = Node()
        bounds: dict[int, Bound] = {}
        for number, field in enumerate(spec.fields):
            if field.source.kind == "state":
                bound = bind_state(field, arrays, names or {})
                bounds[number] = place_state(root, message, number, bound)
            else:
                value = field.source.value
                if field.source.kind == "variable":
                    value = bind_variable(field, variables or {})
                place_constant(root, message, field, value)
        try:
            template = Template(message, root)
        except MapStateError as error:
            raise MapStateError(error.message, spec.where) from None
        checksum = None
        for field in spec.fields:
            if field.checksum is not None:
                checksum = unitree_crc(field, message, template.data)
        encode, source = generate(template, bounds, checksum)
        return cls(spec, encode, source, len(template.data))
