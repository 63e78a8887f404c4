"""Message definitions as plain data, for the layouts: what fields a type has, in which order.

`Messages` wraps a rosbags typestore (facts only: field names, types, bounds, constants) and adds
definitions from `.msg` texts, files and folders, those that ship in `unicon_msgs_map/msg`, and
those of installed packages, which are looked for last.
The types of Jazzy lie ready-made in `jazzy.json`, since rosbags makes classes of all types of all
distributions before it, in 90 ms: the typestore is made where more than a layout is wanted.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base import AnyDict, AnyMapping, alternatives, one_line
from unicon_msgs_map.errors import MapDependencyError, MessageTypeError
from unicon_msgs_map.layout.installed import SHIPPED, installed_files, ready_made, unknown_type

DEFAULT_DISTRO = "jazzy"

# rosidl's rules, and `_` for the messages of actions
_TYPE_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*/[a-z]+/[A-Za-z][A-Za-z0-9_]*")
_FIELD_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
MAX_NESTED = 32
MAX_TEXT = 1 << 20

DURATION = "builtin_interfaces/msg/Duration"
TIME = "builtin_interfaces/msg/Time"
HEADER = "std_msgs/msg/Header"
QUATERNION = "geometry_msgs/msg/Quaternion"


@dataclass(frozen=True, eq=False)  # one of each, in PRIMITIVES
class Primitive:
    """A number on the wire.

    Attributes:
        name: the `.msg` name, such as `float64`.
        size: bytes, which is also its CDR alignment.
        code: the `struct` format letter.
        dtype: the little-endian NumPy dtype string.
    """

    name: str
    size: int
    code: str
    dtype: str


@dataclass(frozen=True)
class String:
    """Length word (with the terminator), UTF-8 bytes, one NUL; `bound` 0 is unbounded."""

    bound: int = 0


@dataclass(frozen=True)
class Array:
    """A fixed array (`length` set) or a sequence (`length` None; `bound` 0 is unbounded)."""

    item: Primitive | String | Struct
    length: int | None
    bound: int = 0

    @property
    def most(self) -> int | None:
        """The largest number of elements; None where there is no limit."""
        return self.bound or None if self.length is None else self.length


@dataclass(frozen=True, eq=False)
class Struct:
    """A message type: its fields' types in wire order and its constants, both by name."""

    name: str
    fields: dict[str, TypeRef]
    constants: dict[str, bool | int | float | str]

    @property
    def is_time(self) -> bool:
        """Whether it is a Time or a Duration, which is one number of ours in [ns]."""
        return self.name in (TIME, DURATION)


TypeRef = Primitive | String | Struct | Array

PRIMITIVES = {
    name: Primitive(name, struct.calcsize("<" + code), code, np.dtype("<" + code).str)
    for name, code in {
        "bool": "?",
        "byte": "B",  # rosbags reads octets as signed; ROS 2 says unsigned
        "char": "B",
        "int8": "b",
        "uint8": "B",
        "int16": "h",
        "uint16": "H",
        "int32": "i",
        "uint32": "I",
        "int64": "q",
        "uint64": "Q",
        "float32": "f",
        "float64": "d",
    }.items()
}


@dataclass(frozen=True)
class MessageDefinition:
    """What a recorder or viewer wants to know of a type.

    Attributes:
        name: full name, such as `sensor_msgs/msg/JointState`.
        text: the definition with those of its parts, as MCAP's and Foxglove's `ros2msg` has it.
        rihs: the type hash of REP-2011, `RIHS01_…`.
        md5: the ROS 1 style sum of the definition.
        encoding: the schema encoding of `text`.
    """

    name: str
    text: str
    rihs: str
    md5: str
    encoding: str = "ros2msg"


class Messages:
    """The message types that mappings may use.

    Args:
        distro: ROS distribution whose common interfaces are known from the start (`jazzy`; also
            `ros2_jazzy`), or a rosbags typestore to build upon.

    Raises:
        MessageTypeError: the distribution is unknown.
        MapDependencyError: rosbags is not installed; for Jazzy, where `store` is asked for.
    """

    def __init__(self, distro: str | Any = DEFAULT_DISTRO) -> None:
        self._ready: AnyMapping = {}
        if not isinstance(distro, str):
            self.store = distro
        elif _short(distro) == DEFAULT_DISTRO:
            self._ready = ready_made()
        else:
            self.store = _typestore(distro)
        self._structs: dict[str, Struct] = {}
        self._shipped: set[str] = set()
        self._building: list[str] = []

    @cached_property
    def store(self) -> Any:
        """The rosbags typestore.

        Raises:
            MapDependencyError: rosbags is not installed.
        """
        return _typestore(DEFAULT_DISTRO)

    def struct(self, name: str) -> Struct:
        """Return the layout of a type, given as `pkg/msg/Name` or `pkg/Name`.

        Raises:
            MessageTypeError: it is unknown, or holds something that is not laid out here.
        """
        full = full_name(name)
        known = self._structs.get(full)
        if known is None:
            known = self._structs[full] = self._build(full)
        return known

    def knows(self, name: str) -> bool:
        """Tell whether a type is defined."""
        full = full_name(name)
        if full in self._ready:
            return True
        if full not in self.store.fielddefs:
            self._register_shipped(full.split("/")[0])
        if full not in self.store.fielddefs:
            for path in installed_files(full):
                self.register_path(path)
        return full in self.store.fielddefs

    def register_path(self, path: str | Path) -> None:
        """Add the type `<package>[/msg]/<Name>.msg`, or all of the folder `<package>[/msg]`."""
        path = Path(path)
        files = sorted(path.glob("*.msg")) if path.is_dir() else [path]
        if not files:
            raise MessageTypeError(
                f"folder {str(path)!r} holds no .msg file; give the folder that holds them"
            )
        folder = files[0].parent
        package = folder.parent.name if folder.name == "msg" else folder.name
        self.register({f"{package}/msg/{file.stem}": _read(file) for file in files})

    def definition(self, name: str) -> MessageDefinition:
        """Return text and hashes of a type, as MCAP and Foxglove need them."""
        full = self.struct(name).name
        text, md5 = self.store.generate_msgdef(full, ros_version=2)
        return MessageDefinition(full, text, self.store.hash_rihs01(full), md5)

    def register(self, texts: dict[str, str]) -> None:
        """Add types; names of their own package may stand in a text without the package.

        Args:
            texts: of `.msg` files, by `pkg/msg/Name`.

        Raises:
            MessageTypeError: a text is not a definition, or contradicts one that is known.
        """
        from rosbags.typesys import get_types_from_msg

        found: AnyDict = {}
        for name, text in texts.items():
            full_name(name)
            try:
                found.update(get_types_from_msg(text, name))
            except Exception as error:
                reason = one_line(error)
                raise MessageTypeError(
                    f"definition of {name!r} cannot be parsed: {reason}"
                ) from None
        for name, definition in found.items():
            _check_names(name, definition)  # the store makes Python of them
        try:
            self.store.register(found)
        except Exception as error:
            raise MessageTypeError(
                f"{error} Rename the type, or drop one of the two definitions."
            ) from None

    def _register_shipped(self, package: str) -> None:
        if package in self._shipped:
            return
        self._shipped.add(package)
        folder = SHIPPED / package
        if folder.is_dir():
            self.register(
                {
                    f"{package}/msg/{entry.name[:-4]}": entry.read_text("utf-8")
                    for entry in folder.iterdir()
                    if entry.name.endswith(".msg")
                }
            )

    def _build(self, full: str) -> Struct:
        if full in self._building or len(self._building) > MAX_NESTED:
            raise MessageTypeError(
                f"message type {full!r} holds itself, or parts more than {MAX_NESTED} deep; "
                "correct its definition"
            )
        self._building.append(full)
        try:
            if not self.knows(full):
                raise unknown_type(full, self.store.fielddefs)
            constants, fielddefs = self._ready.get(full) or self.store.fielddefs[full]
            fields = {name: self._type(full, name, desc) for name, desc in fielddefs}
        finally:
            self._building.pop()
        if not fields:  # an empty message has one byte on the wire
            fields["structure_needs_at_least_one_member"] = PRIMITIVES["uint8"]
        return Struct(full, fields, {name: value for name, _, value in constants})

    def _type(self, owner: str, field: str, desc: Any) -> TypeRef:
        kind, rest = int(desc[0]), desc[1]
        if kind == 1:  # base type
            return _base(owner, field, rest)
        if kind == 2:  # another message
            if rest.split("/")[-1] in ("wstring", "wchar", "float128"):  # so .msg texts are read
                return _base(owner, field, (rest.split("/")[-1], 0))
            return self.struct(rest)
        item = self._type(owner, field, rest[0])
        if isinstance(item, Array):
            raise MessageTypeError(f"{owner}.{field}: arrays of arrays are not laid out")
        return Array(item, rest[1]) if kind == 3 else Array(item, None, rest[1])


def message_definition(name: str) -> MessageDefinition:
    """Return the definition text and hashes of a type of Jazzy or our own."""
    return shared_messages().definition(name)


@cache
def shared_messages() -> Messages:
    """Return the one store that callers share; register nothing into it."""
    return Messages()


def full_name(name: str) -> str:
    """Return `pkg/msg/Name` for `pkg/Name` and `pkg/msg/Name`."""
    parts = name.split("/")
    if len(parts) == 2:
        parts.insert(1, "msg")
    if len(name) > 255 or not _TYPE_NAME.fullmatch("/".join(parts)):
        shown = name if len(name) <= 60 else f"{name[:57]}…"
        raise MessageTypeError(
            f"message type {shown!r} is not a type name; write pkg/msg/Name, "
            "such as sensor_msgs/msg/JointState"
        )
    return "/".join(parts)


def _check_names(name: str, definition: Any) -> None:
    full_name(name)
    constants, fields = definition
    for field, *_ in (*constants, *fields):
        if not _FIELD_NAME.fullmatch(field):
            raise MessageTypeError(f"definition of {name!r}: {field!r} is not a name of a field")
    for field, kind in fields:
        while kind[0] > 2:
            kind = kind[1][0]
        if kind[0] == 2:
            try:
                full_name(kind[1])
            except MessageTypeError as error:
                raise MessageTypeError(f"definition of {name!r}: {field}: {error}") from None


def _base(owner: str, field: str, rest: Any) -> Primitive | String:
    if rest[0] == "string":
        return String(int(rest[1] or 0))
    primitive = PRIMITIVES.get(rest[0])
    if primitive is None:
        raise MessageTypeError(
            f"{owner}.{field}: {rest[0]} is not laid out; use string or one of "
            f"{', '.join(PRIMITIVES)}"
        )
    return primitive


def _typestore(distro: str) -> Any:
    try:
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise MapDependencyError(
            f"the message map needs rosbags ({error}): pip install rosbags"
        ) from None
    short = _short(distro)
    known = {s.value.removeprefix("ros2_"): s for s in Stores if s.value.startswith("ros2_")}
    if short not in known:
        raise MessageTypeError(f"typestore {distro!r} is unknown; {alternatives(short, known)}")
    return get_typestore(known[short])


def _short(distro: str) -> str:
    return distro.lower().removeprefix("ros2_")


def _read(path: Path) -> str:
    try:
        with path.open("rb") as file:
            return file.read(MAX_TEXT).decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise MessageTypeError(
            f"cannot read message file {str(path)!r}: {getattr(error, 'strerror', None) or error}"
        ) from None
