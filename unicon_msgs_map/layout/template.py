"""The CDR template of a message: constants written, every mapped number at a known offset.

For encoders. Lengths and strings are fixed here, at build; what changes per message comes back
as `Numbers`, `Time` and `Text` slots. The plain CDR rules (XCDR1, little endian): every number is
aligned to its size, counted from the end of the 4-byte encapsulation header.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field

from unicon_msgs_map.errors import MapStateError, MessageTypeError, count_of
from unicon_msgs_map.layout.check import field_type
from unicon_msgs_map.layout.messages import (
    DURATION,
    QUATERNION,
    TIME,
    Array,
    Primitive,
    String,
    Struct,
    TypeRef,
)
from unicon_msgs_map.layout.paths import Key, Path
from unicon_msgs_map.spec import FieldSpec

__all__ = ["Leaf", "Node", "Slot", "Template", "expand", "numeric_leaves", "place"]

LARGEST = 4 << 20  # of one message, [B]; pictures and clouds go another way
HEADER_LE = b"\x00\x01\x00\x00"
Where = tuple[str | int, ...]


@dataclass(frozen=True)
class Leaf:
    """One target of a field: a concrete place in the message and its type."""

    at: Where
    type: TypeRef


@dataclass(frozen=True)
class Slot:
    """Something that changes per message.

    Attributes:
        offset: in the payload with its header, [B].
        kind: `number`, `time` (sec and nanosec from int64 ns) or `text` (fixed width).
        source: index of the field.
        element: index into the state's flat view.
        rank: position of the element in its field (for per-element scale and offset).
        primitive: wire type of a number.
        width: of a text, [B].
    """

    offset: int
    kind: str
    source: int
    element: int
    rank: int
    primitive: Primitive | None = None
    width: int = 0


@dataclass
class Node:
    """What is placed at one point of the message tree."""

    children: dict[str | int, Node] = field(default_factory=dict)
    value: object = None
    owner: str = ""

    def child(self, key: str | int) -> Node | None:
        """Return the node below, where something was placed."""
        return self.children.get(key)


@dataclass(frozen=True)
class Place:
    """Value of a node that a state fills: which field, which elements, from which rank on."""

    kind: str
    source: int
    elements: tuple[int, ...]
    rank: int
    width: int = 0


def expand(spec: FieldSpec, root: Struct, available: int | None) -> list[Leaf]:
    """Return the concrete places that a path names, in element order.

    Args:
        spec: the field.
        root: type of the message.
        available: number of elements on our side, which sets the end of open ranges and the
            length of whole sequences; None for a constant.

    Raises:
        MessageTypeError: a step names no field, or selects where there is no array.
    """
    return _expand(spec, root, spec.steps, (), root, available)


def _expand(
    spec: FieldSpec,
    root: Struct,
    steps: Path,
    at: Where,
    owner: TypeRef,
    available: int | None,
) -> list[Leaf]:
    if not steps:
        return [Leaf(at, owner)]
    if not isinstance(owner, Struct):
        parent = ".".join(str(part) for part in at)
        raise MessageTypeError(
            f"{spec.path}: {parent} of {root.name} has no fields below it", spec.where
        )
    (name, selector), rest = steps[0], steps[1:]
    here, kind = (*at, name), field_type(spec, owner, name, selector, last=not rest)
    if not isinstance(kind, Array):
        return _expand(spec, root, rest, here, kind, available)
    if selector is None:
        return [Leaf(here, kind)]
    if isinstance(selector, Key):
        raise MessageTypeError(
            f"{spec.path}: elements are selected by text in subscriptions only; "
            f"use a number, as in {name}[0]",
            spec.where,
        )
    limit = kind.length if kind.length is not None else (kind.bound or None)
    if isinstance(selector, int):
        start, stop = selector, selector + 1
    elif selector[1] is not None:
        start, stop = selector[0], selector[1]
    else:
        start = selector[0]
        stop = start + _open_end(spec, kind, rest, available)
    if limit is not None and (stop > limit or start >= limit):
        raise MessageTypeError(
            f"{spec.path}: {name} of {owner.name} has at most {count_of(limit)}", spec.where
        )
    leaves: list[Leaf] = []
    for index in range(start, stop):
        leaves += _expand(spec, root, rest, (*here, index), kind.item, available)
    return leaves


def _open_end(spec: FieldSpec, kind: Array, rest: Path, available: int | None) -> int:
    if available is None:
        raise MessageTypeError(
            f"{spec.path}: an open range takes its end from a state; give a number after ':'",
            spec.where,
        )
    root = kind.item if isinstance(kind.item, Struct) else Struct("", (), {})
    each = _expand(spec, root, rest, (), kind.item, available)
    size = sum(leaf_size(leaf.type, spec) for leaf in each)
    return available // size


def leaf_size(kind: TypeRef, spec: FieldSpec) -> int:
    """Return how many of our elements a target takes.

    Raises:
        MessageTypeError: its length is open.
    """
    if isinstance(kind, Array):
        if kind.length is None:
            raise MessageTypeError(
                f"{spec.path}: the length of a sequence inside a range is not known; "
                "map its elements, as in points[0].positions",
                spec.where,
            )
        return kind.length * leaf_size(kind.item, spec)
    if isinstance(kind, Struct) and kind.name not in (TIME, DURATION):
        return sum(leaf_size(f.type, spec) for f in kind.fields)
    return 1


def numeric_leaves(leaf: Leaf, spec: FieldSpec) -> list[Leaf]:
    """Return the numbers of a target that is a message, such as a Vector3; others as they are.

    Raises:
        MessageTypeError: the message holds more than numbers.
    """
    if not isinstance(leaf.type, Struct) or leaf.type.name in (TIME, DURATION):
        return [leaf]
    found: list[Leaf] = []
    for member in leaf.type.fields:
        if isinstance(member.type, String) or (
            isinstance(member.type, Array)
            and not (isinstance(member.type.item, Primitive) and member.type.length is not None)
        ):
            raise MessageTypeError(
                f"{spec.path}: {leaf.type.name} holds more than numbers; "
                f"map its fields, as in {spec.path}.{member.name}",
                spec.where,
            )
        found += numeric_leaves(Leaf((*leaf.at, member.name), member.type), spec)
    return found


def place(root: Node, leaf: Leaf, value: object, spec: FieldSpec) -> None:
    """Put a value into the tree.

    Raises:
        MapStateError: the place is taken.
    """
    node = root
    for key in leaf.at:
        if node.value is not None:
            raise MapStateError(
                f"{spec.path}: already mapped by {node.owner}; drop one of the two", spec.where
            )
        node = node.children.setdefault(key, Node())
    if node.value is not None or node.children:
        owner = node.owner or next(_owners(node), "another field")
        raise MapStateError(
            f"{spec.path}: already mapped by {owner}; drop one of the two", spec.where
        )
    node.value, node.owner = value, spec.path


def _owners(node: Node) -> Iterator[str]:
    if node.value is not None:
        yield node.owner
    for child in node.children.values():
        yield from _owners(child)


class Template:
    """Bytes of a message and the slots in them.

    Args:
        message: its type.
        root: what is placed where.

    Attributes:
        data: the payload with its header; slots hold zeros.
        slots: what changes, by offset.
    """

    def __init__(self, message: Struct, root: Node) -> None:
        self.data = bytearray(HEADER_LE)
        self.slots: list[Slot] = []
        self._struct(message, root)

    def _align(self, size: int) -> None:
        if len(self.data) > LARGEST:
            raise MapStateError(
                f"the message takes more than {LARGEST >> 20} MiB; map fewer elements"
            )
        self.data += bytes(-(len(self.data) - 4) % size)

    def _any(self, kind: TypeRef, node: Node | None) -> None:
        if isinstance(kind, Primitive):
            self._primitive(kind, node)
        elif isinstance(kind, String):
            self._string(kind, node)
        elif isinstance(kind, Struct):
            self._struct(kind, node)
        else:
            self._array(kind, node)

    def _struct(self, kind: Struct, node: Node | None) -> None:
        value = node.value if node else None
        if isinstance(value, Place) and value.kind == "time":
            self._align(4)
            self.slots.append(
                Slot(len(self.data), "time", value.source, value.elements[0], value.rank)
            )
            self.data += bytes(8)
            return
        if node is None and kind.name == QUATERNION:
            # geometry_msgs/Quaternion declares w = 1 as its default; zeros would be no rotation.
            self._align(8)
            self.data += struct.pack("<4d", 0.0, 0.0, 0.0, 1.0)
            return
        for member in kind.fields:
            self._any(member.type, node.child(member.name) if node else None)

    def _primitive(self, kind: Primitive, node: Node | None) -> None:
        self._align(kind.size)
        value = node.value if node else None
        if isinstance(value, Place):
            self.slots.append(
                Slot(len(self.data), "number", value.source, value.elements[0], value.rank, kind)
            )
            value = None
        self._number(kind, 0 if value is None else value)

    def _number(self, kind: Primitive, value: object) -> None:
        self.data += struct.pack("<" + kind.code, value)

    def _string(self, kind: String, node: Node | None) -> None:
        self._align(4)
        value = node.value if node else None
        if isinstance(value, Place):
            self.data += struct.pack("<I", value.width + 1)
            self.slots.append(
                Slot(
                    len(self.data),
                    "text",
                    value.source,
                    value.elements[0],
                    value.rank,
                    width=value.width,
                )
            )
            self.data += bytes(value.width + 1)
            return
        text = str(value or "").encode()
        self.data += struct.pack("<I", len(text) + 1) + text + b"\0"

    def _array(self, kind: Array, node: Node | None) -> None:
        value = node.value if node else None
        children = node.children if node else {}
        if kind.length is not None:
            count = kind.length
        else:
            if isinstance(value, Place):
                count = len(value.elements)
            elif isinstance(value, list):
                count = len(value)
            else:
                count = 1 + max((int(key) for key in children), default=-1)
            self._align(4)
            self.data += struct.pack("<I", count)
        for index in range(count):
            item: Node | None
            if isinstance(value, Place):
                one = Place(
                    value.kind, value.source, (value.elements[index],), value.rank + index, 0
                )
                item = Node(value=one)
            elif isinstance(value, list):
                item = Node(value=value[index])
            else:
                item = children.get(index)
            self._any(kind.item, item)
