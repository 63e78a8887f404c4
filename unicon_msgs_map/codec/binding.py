"""Our side of a field: arrays, element names, variables and conversions, resolved once at build.

Shared by encoders and decoders, as is what numbers of a type can hold. A `Bound` names the flat
view of a state and which of its elements take part, in message order. Arrays of one state buffer,
such as joint_pos, joint_vel and joint_effort, lie at even distances, and so do the sequences of one
message: `fuse` finds those that a two-dimensional strided view (`stack`) copies at once.

And checksums that some robots want inside a message: Unitree's CRC over its C structs. Facts from
unitreerobotics/unitree_ros2, example/src/src/common/motor_crc.cpp: polynomial 0x04c11db7, start
0xffffffff, most significant bit of each 32-bit word first, over the message as a C struct (natural
alignment, padding zero) without its last word, which is the checksum itself.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from unicon_base import alternatives
from unicon_msgs_map.errors import count_of
from unicon_msgs_map.layout.messages import (
    PRIMITIVES,
    QUATERNION,
    Array,
    Primitive,
    String,
    Struct,
    TypeRef,
)
from unicon_msgs_map.spec import PER_SI, FieldSpec

AnyArray = NDArray[Any]
Arrays = Mapping[str, AnyArray]
Names = Mapping[str, Sequence[str]]
Variables = Mapping[str, object]
Conversion = tuple[AnyArray, AnyArray]
"""Factor and summand per element."""

_KINDS = frozenset("biuf")
# xyzw on the wire, wxyz in the states: message element k is state element _WXYZ[k].
_WXYZ = (1, 2, 3, 0)


@dataclass(frozen=True)
class Bound:
    """A state as one field uses it.

    Attributes:
        field: the mapping's entry.
        flat: 1-D view of the whole state array.
        elements: indices into `flat`, in message order.
        names: element names of the selection, where the state has any.
        conversion: in message order; None where nothing is converted.
    """

    field: FieldSpec
    flat: AnyArray
    elements: tuple[int, ...]
    names: tuple[str, ...] | None
    conversion: Conversion | None = None

    @property
    def is_float(self) -> bool:
        """Whether the state is a floating point array."""
        return self.flat.dtype.kind == "f"


def bind_state(field: FieldSpec, arrays: Arrays, names: Names) -> Bound:
    """Resolve a field's state reference.

    Raises:
        MapStateError: no such state, element or range, or an array that cannot be used in place.
    """
    name = field.source.name
    array = arrays.get(name)
    if array is None:
        raise field.state_error(
            f"no state {name!r}; {alternatives(name, arrays)}; write ={name} for the text"
        )
    kind, size = array.dtype.kind, array.dtype.itemsize
    if kind not in _KINDS or not array.dtype.isnative or size > 8 or (kind == "f" and size < 4):
        raise field.state_error(
            f"state {name!r} has dtype {array.dtype}; use bool, native integers, float32 or float64"
        )
    flat = array.reshape(-1)
    if array.size and not np.may_share_memory(flat, array):
        raise field.state_error(
            f"state {name!r} with shape {array.shape} and strides {array.strides} is not one "
            "evenly spaced run; give a contiguous array"
        )
    own = tuple(names[name]) if name in names else None
    if own is not None and len(own) != flat.size:
        own = None  # names of one axis of a batch do not name flat elements
    elements = _select(field, flat.size, own)
    return Bound(field, flat, elements, tuple(own[i] for i in elements) if own else None)


def bind_variable(field: FieldSpec, variables: Variables) -> object:
    """Return a variable's value.

    Raises:
        MapStateError: it is not given.
    """
    name = field.source.name
    if name not in variables:
        raise field.state_error(
            f"no variable ${name}; {alternatives(name, variables)}; variables are given when the "
            "map is built"
        )
    return variables[name]


def message_order(elements: tuple[int, ...], field: FieldSpec, kind: TypeRef) -> tuple[int, ...]:
    """Return a field's elements as the message orders them: of quaternions, wxyz becomes xyzw.

    Args:
        elements: in the state's order.
        field: the mapping's entry.
        kind: the type that its path ends at.

    Raises:
        MapStateError: the number of elements is not a multiple of four.
    """
    whole = isinstance(kind, Struct) and kind.name == QUATERNION
    if field.quat == "none" or (field.quat is None and not whole):
        return elements
    if len(elements) % 4:
        raise field.state_error(f"a quaternion has 4 elements, {field.source} has {len(elements)}")
    groups = range(0, len(elements), 4)
    return tuple(elements[start + k] for start in groups for k in _WXYZ)


def affine(field: FieldSpec, count: int, *, receive: bool) -> Conversion | None:
    """Return factor and summand per element, or None where nothing is converted.

    Args:
        field: the mapping's entry.
        count: number of elements.
        receive: from message to state (the unit divides) instead of state to message.

    Raises:
        MapStateError: a per-element list does not have `count` entries.
    """
    factor = PER_SI[field.unit] if field.unit else 1.0
    for label, value in (("scale", field.scale), ("offset", field.offset)):
        if isinstance(value, tuple) and len(value) != count:
            raise field.state_error(
                f"{label} has {len(value)} entries for {count_of(count)}; give one number or one "
                "per element"
            )
    scale = np.broadcast_to(np.asarray(field.scale, np.float64), (count,))
    scale = scale / factor if receive else scale * factor
    offset = np.broadcast_to(np.asarray(field.offset, np.float64), (count,)).copy()
    if bool(np.all(scale == 1.0)) and not offset.any():
        return None
    return np.ascontiguousarray(scale), offset


def _select(field: FieldSpec, size: int, names: tuple[str, ...] | None) -> tuple[int, ...]:
    index, name = field.source.index, field.source.name
    if index is None:
        return tuple(range(size))
    if isinstance(index, str):
        if names is None:
            raise field.state_error(
                f"state {name!r} has no element names; use a number, as in {name}[0]"
            )
        if index not in names:
            raise field.state_error(
                f"state {name!r} has no element {index!r}; {alternatives(index, names)}"
            )
        return (names.index(index),)
    start, stop = (index, index + 1) if isinstance(index, int) else index
    stop = size if stop is None else stop
    if stop > size or start >= size:
        raise field.state_error(
            f"{field.source} is out of range; state {name!r} has {count_of(size)}"
        )
    return tuple(range(start, stop))


SINGLE_MAX = float(np.finfo(np.float32).max)
DOUBLE_MAX = float(np.finfo(np.float64).max)


def limits(dtype: np.dtype[Any] | str) -> tuple[int, int]:
    """Return the smallest and largest integer of a dtype."""
    info = np.iinfo(dtype)
    return int(info.min), int(info.max)


Member = TypeVar("Member")


def step(values: Sequence[int]) -> int | None:
    """Return the distance of evenly spaced numbers; None for others."""
    steps = {b - a for a, b in pairwise(values)}
    return steps.pop() if len(steps) == 1 else None


def address(array: AnyArray) -> int:
    """Return where an array begins in memory."""
    return int(array.__array_interface__["data"][0])


def memory(array: AnyArray) -> int:
    """Return what tells the memory that an array is a view of from others."""
    owner: object = array
    while (below := getattr(owner, "base", getattr(owner, "obj", None))) is not None:
        owner = below
    return id(owner)


def line(flat: AnyArray, elements: Sequence[int]) -> AnyArray:
    """Return the view of evenly spaced elements of a 1-D array, shape (len(elements),)."""
    distance = step(elements)
    assert distance is not None
    first = flat[elements[0] : elements[0] + 1]
    return as_strided(first, (len(elements),), (distance * flat.strides[0],))


def stack(lines: Sequence[AnyArray]) -> AnyArray:
    """Return one view of lines of equal form at even distances, shape (len(lines), n).

    Every element of it lies in one of the lines, which the caller must keep alive. Lines are views
    of one memory: what NumPy allocates for a copy must not lie between them, since NumPy (2.5)
    compares the outer bounds only, takes a copy of what may overlap, and does so again and again.
    """
    first = lines[0]
    if len(lines) == 1:
        return first
    between = address(lines[1]) - address(first)
    return as_strided(first, (len(lines), *first.shape), (between, *first.strides))


def fuse(
    members: Iterable[Member],
    form: Callable[[Member], object],
    places: Callable[[Member], Sequence[int]],
) -> list[list[Member]]:
    """Group consecutive members of equal form that lie at even distances.

    Args:
        members: in the order of their places.
        form: what two members must have alike.
        places: where a member begins in each memory that counts, [B].
    """

    def apart(a: Member, b: Member) -> list[int]:
        return [end - start for start, end in zip(places(a), places(b))]

    groups: list[list[Member]] = []
    for member in members:
        group = groups[-1] if groups else []
        even = len(group) < 2 or apart(group[-1], member) == apart(group[0], group[1])
        if group and form(group[-1]) == form(member) and even:
            group.append(member)
        else:
            groups.append([member])
    return groups


# zlib's CRC has the same polynomial with bits reversed: reverse the input's and the result's.
_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def unitree_crc(field: FieldSpec, message: Struct, buffer: bytearray) -> Callable[[], int]:
    """Return a function that computes the checksum of what the buffer holds (about 3 µs).

    Args:
        field: the mapping's entry, which names the last field.
        message: its type.
        buffer: payload with header; its first byte is zero and stands for all padding.

    Raises:
        MapStateError: the message is not a C struct that ends in a uint32 checksum.
    """
    last = list(message.fields)[-1]
    if field.path != last or message.fields[last] is not PRIMITIVES["uint32"]:
        raise field.state_error(
            f"Unitree's checksum is a uint32 at the end of the message; "
            f"{message.name} ends in {last}"
        )
    index: list[int] = []  # where each byte of the C struct stands on the wire, 0 for padding
    at = 4

    def walk(kind: TypeRef) -> None:
        nonlocal at
        index.extend([0] * (-len(index) % _alignment(kind)))
        if isinstance(kind, Primitive):
            at += -(at - 4) % kind.size
            index.extend(range(at, at + kind.size))
            at += kind.size
        elif isinstance(kind, Struct):
            for member in kind.fields.values():
                walk(member)
            index.extend([0] * (-len(index) % _alignment(kind)))
        elif isinstance(kind, Array) and kind.length is not None:
            for _ in range(kind.length):
                walk(kind.item)
        else:
            raise field.state_error(
                "a message with strings or sequences is not a C struct; Unitree's checksum covers "
                "LowCmd and its kin"
            )

    walk(message)
    return _crc_of(buffer, np.array(index[:-4], np.intp))


def words_crc(buffer: bytearray, words: int) -> Callable[[], int]:
    """Return a function that computes the checksum of the first words of a buffer (about 2 µs).

    Args:
        buffer: little-endian 32-bit words without gaps, such as a datagram of unitree_legged_sdk.
        words: how many of them count.
    """
    return _crc_of(buffer, np.arange(4 * words))


def _crc_of(buffer: bytearray, index: NDArray[np.intp]) -> Callable[[], int]:
    """Return what computes the checksum of the words whose bytes stand at an index, low first."""
    index = np.ascontiguousarray(index.reshape(-1, 4)[:, ::-1]).reshape(-1)
    source = np.frombuffer(buffer, np.uint8)
    image = bytearray(len(index))
    target = np.frombuffer(image, np.uint8)

    def compute() -> int:
        source.take(index, None, target, "clip")
        value = zlib.crc32(image.translate(_REVERSED)) ^ 0xFFFFFFFF
        return int.from_bytes(value.to_bytes(4, "little").translate(_REVERSED), "big")

    return compute


def _alignment(kind: TypeRef) -> int:
    if isinstance(kind, Primitive):
        return kind.size
    if isinstance(kind, Array):
        return _alignment(kind.item)
    if isinstance(kind, String):
        return 4
    return max(map(_alignment, kind.fields.values()))
