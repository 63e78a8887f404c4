"""Paths checked against message types, and the CDR template with every mapped number's offset.

The checks need no arrays: a file is checked when it is read. The template is for encoders: lengths
and strings are fixed when it is built; what changes per message comes back as slots. The plain CDR
rules (XCDR1, little endian): every number is aligned to its size, counted from the end of the
4-byte encapsulation header.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from unicon_base import alternatives
from unicon_msgs_map.errors import MapStateError, count_of
from unicon_msgs_map.layout.messages import QUATERNION, Array, Primitive, String, Struct, TypeRef
from unicon_msgs_map.layout.paths import Key, Path, Selector
from unicon_msgs_map.spec import FieldSpec

LARGEST = 4 << 20  # of one message, [B]; pictures and clouds go another way
HEADER_LE = b"\x00\x01\x00\x00"
Where = tuple[str | int, ...]


@dataclass(frozen=True)
class Leaf:
    """One target of a field: a concrete place in the message, its type, and what it lies in."""

    at: Where
    type: TypeRef
    owner: Struct


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
    """What is placed at one point of the message tree, and which field came first to it."""

    children: dict[str | int, Node] = field(default_factory=dict)
    value: object = None
    owner: str = ""


@dataclass(frozen=True)
class Place:
    """Value of a node that a state fills: which field, which elements, from which rank on."""

    kind: str
    source: int
    elements: tuple[int, ...]
    rank: int
    width: int = 0


def expand(spec: FieldSpec, steps: Path, leaf: Leaf, available: int | None) -> list[Leaf]:
    """Return the concrete places that a path names, in element order.

    Args:
        spec: the field, for messages.
        steps: the path, which fits the type (`layout.check.resolve`).
        leaf: where it begins.
        available: number of elements on our side, which sets the end of open ranges and the
            length of whole sequences; None for a constant.

    Raises:
        MessageTypeError: an open range has no end, or the array is shorter.
    """
    if not steps:
        return [leaf]
    owner = leaf.type
    assert isinstance(owner, Struct)
    (name, selector), rest = steps[0], steps[1:]
    here, kind = (*leaf.at, name), owner.fields[name]
    if selector is None or not isinstance(kind, Array):
        return expand(spec, rest, Leaf(here, kind, owner), available)
    assert not isinstance(selector, Key)
    start, stop = (selector, selector + 1) if isinstance(selector, int) else selector
    if stop is None:
        if available is None:
            raise spec.type_error(
                "an open range takes its end from a state; give a number after ':'"
            )
        each = expand(spec, rest, Leaf(here, kind.item, owner), available)
        stop = start + available // sum(leaf_size(leaf.type, spec) for leaf in each)
    if kind.most is not None and stop > kind.most:
        raise spec.type_error(f"{name} of {owner.name} has at most {count_of(kind.most)}")
    leaves: list[Leaf] = []
    for index in range(start, stop):
        leaves += expand(spec, rest, Leaf((*here, index), kind.item, owner), available)
    return leaves


def leaf_size(kind: TypeRef, spec: FieldSpec) -> int:
    """Return how many of our elements a target takes.

    Raises:
        MessageTypeError: its length is open.
    """
    if isinstance(kind, Array):
        if kind.length is None:
            raise spec.type_error(
                "the length of a sequence inside a range is not known; map its elements, as in "
                "points[0].positions"
            )
        return kind.length * leaf_size(kind.item, spec)
    if isinstance(kind, Struct) and not kind.is_time:
        return sum(leaf_size(member, spec) for member in kind.fields.values())
    return 1


def numeric_leaves(leaf: Leaf, spec: FieldSpec) -> list[Leaf]:
    """Return the numbers of a target that is a message, such as a Vector3; others as they are.

    Raises:
        MessageTypeError: the message holds more than numbers.
    """
    if not isinstance(leaf.type, Struct) or leaf.type.is_time:
        return [leaf]
    found: list[Leaf] = []
    for name, member in leaf.type.fields.items():
        if isinstance(member, String) or (
            isinstance(member, Array)
            and not (isinstance(member.item, Primitive) and member.length is not None)
        ):
            raise spec.type_error(
                f"{leaf.type.name} holds more than numbers; map its fields, as in "
                f"{spec.path}.{name}"
            )
        found += numeric_leaves(Leaf((*leaf.at, name), member, leaf.type), spec)
    return found


def place(root: Node, leaf: Leaf, value: object, spec: FieldSpec) -> None:
    """Put a value into the tree.

    Raises:
        MapStateError: the place is taken.
    """
    node = root
    for key in leaf.at:
        if node.value is not None:
            raise spec.state_error(f"already mapped by {node.owner}; drop one of the two")
        node = node.children.setdefault(key, Node(owner=spec.path))
    if node.value is not None or node.children:
        raise spec.state_error(f"already mapped by {node.owner}; drop one of the two")
    node.value = value


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
            self._string(node)
        elif isinstance(kind, Struct):
            self._struct(kind, node)
        else:
            self._array(kind, node)

    def _struct(self, kind: Struct, node: Node | None) -> None:
        if node is not None and isinstance(node.value, Place):  # a Time or Duration
            self._align(4)
            self._slot(node.value)
            self.data += bytes(8)
            return
        if node is None and kind.name == QUATERNION:
            # geometry_msgs/Quaternion declares w = 1 as its default; zeros would be no rotation.
            self._align(8)
            self.data += struct.pack("<4d", 0.0, 0.0, 0.0, 1.0)
            return
        for name, member in kind.fields.items():
            self._any(member, node.children.get(name) if node else None)

    def _slot(self, place: Place, primitive: Primitive | None = None) -> None:
        self.slots.append(
            Slot(
                len(self.data),
                place.kind,
                place.source,
                place.elements[0],
                place.rank,
                primitive,
                place.width,
            )
        )

    def _primitive(self, kind: Primitive, node: Node | None) -> None:
        self._align(kind.size)
        value = node.value if node else None
        if isinstance(value, Place):
            self._slot(value, kind)
            value = None
        self.data += struct.pack("<" + kind.code, 0 if value is None else value)

    def _string(self, node: Node | None) -> None:
        self._align(4)
        value = node.value if node else None
        if isinstance(value, Place):
            self.data += struct.pack("<I", value.width + 1)
            self._slot(value)
            self.data += bytes(value.width + 1)
            return
        text = str(value or "").encode()
        self.data += struct.pack("<I", len(text) + 1) + text + b"\0"

    def _array(self, kind: Array, node: Node | None) -> None:
        value = node.value if node else None
        if isinstance(value, Place):
            each = enumerate(value.elements)
            value = [replace(value, elements=(e,), rank=value.rank + k) for k, e in each]
        if isinstance(value, list):
            items = dict(enumerate(Node(value=one) for one in value))
        else:
            items = {int(key): child for key, child in node.children.items()} if node else {}
        count = kind.length
        if count is None:
            count = 1 + max(items, default=-1)
            self._align(4)
            self.data += struct.pack("<I", count)
        for index in range(count):
            self._any(kind.item, items.get(index))


def check_published(field: FieldSpec, message: Struct) -> None:
    """Check a field of a publish entry.

    Raises:
        MessageTypeError: its path names no field.
        MapFileError: it asks for what only subscriptions have.
    """
    resolve(field, message, receive=False)
    if field.by is not None:
        raise field.file_error("'by' orders received arrays; publish with a $variable of names")
    if field.quat == "wxyz_from_xyzw":
        raise field.file_error("quat wxyz_from_xyzw is of subscriptions; write xyzw_from_wxyz")


def check_received(field: FieldSpec, message: Struct, names: Sequence[str]) -> None:
    """Check a field of a subscribe entry.

    Args:
        field: of the entry.
        message: its type.
        names: paths of the entry's variables, one of which may order this field.

    Raises:
        MessageTypeError: its path names no field.
        MapFileError: it asks for what only published messages have.
    """
    kind = resolve(field, message, receive=True)
    if field.text is not None:
        raise field.file_error("'text' formats published strings; drop it")
    if field.checksum is not None:
        raise field.file_error("checksums are written, not checked on receive; drop it")
    if field.quat == "xyzw_from_wxyz":
        raise field.file_error("quat xyzw_from_wxyz is of publishing; write wxyz_from_xyzw")
    if field.source.kind == "variable" and not (
        isinstance(kind, Array) and isinstance(kind.item, String)
    ):
        raise field.file_error(
            "a variable in a subscription names the elements of an array and stands on an "
            "array of strings; write =text for a required text"
        )
    if field.by not in (None, "none", *names):
        known = alternatives(str(field.by), [*names, "none"])
        raise field.file_error(f"by {field.by!r} is not a mapped array of names; {known}")


def resolve(field: FieldSpec, message: Struct, *, receive: bool) -> TypeRef:
    """Return the type that a path ends at.

    Raises:
        MessageTypeError: a step names no field, or selects what is not there.
    """
    owner: TypeRef = message
    kind: TypeRef = message
    for number, (name, selector) in enumerate(field.steps):
        if not isinstance(owner, Struct):
            raise field.type_error(f"{field.steps[number - 1][0]} has no fields below it")
        if name not in owner.fields:
            known = alternatives(name, owner.fields)
            raise field.type_error(f"{owner.name} has no field {name!r}; {known}")
        kind = owner.fields[name]
        if isinstance(kind, Array):
            if selector is not None:
                _check_selector(field, owner, name, selector, kind, receive=receive)
                kind = kind.item
            elif number < len(field.steps) - 1:
                raise field.type_error(
                    f"{name} of {owner.name} is an array; select elements, as in {name}[0] or "
                    f"{name}[:12]"
                )
        elif selector is not None:
            raise field.type_error(f"{name} of {owner.name} is not an array; drop the [...]")
        owner = kind
    return kind


def _check_selector(
    field: FieldSpec, owner: Struct, name: str, selector: Selector, kind: Array, *, receive: bool
) -> None:
    if isinstance(selector, Key):
        if not receive:
            raise field.type_error(
                "elements are selected by text in subscriptions only; use a number, as in "
                f"{name}[0]"
            )
        fields = kind.item.fields if isinstance(kind.item, Struct) else {}
        if not isinstance(fields.get(selector.field), String):
            raise field.type_error(
                f"elements of {name} have no string field {selector.field!r} to select by"
            )
        return
    top = selector + 1 if isinstance(selector, int) else (selector[1] or selector[0] + 1)
    if kind.most is not None and top > kind.most:
        raise field.type_error(f"{name} of {owner.name} has at most {count_of(kind.most)}")
