"""Classes for messages that ROS lacks, made of their definitions: enough to send and take bytes.

rclpy asks a message class for a type support, which generated C code gives otherwise. What goes
through as bytes needs little of it: the name of the type, its hash, its description, and functions
of the middleware's that are never called. These lie in C structures that are filled in here, and
the functions are those of std_msgs/String. So `/tf` leaves from the wheels, which lack tf2_msgs,
and a package may bring a `.msg` without generated code.

For rmw_fastrtps_cpp alone: others lay messages out by members that a generated class has. Layouts:
`rosidl_runtime_c/message_type_support_struct.h` and
`rosidl_typesupport_fastrtps_cpp/message_type_support.h`; Humble's are beginnings of the newer ones.
"""

from __future__ import annotations

import ctypes
import hashlib
import json
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

from unicon_base import AnyDict
from unicon_msgs_map import MapError, Messages
from unicon_msgs_map.layout.messages import Array, Primitive, String, Struct, TypeRef
from unicon_ros.compat.loading import fast_dds_profiles, message_class, middleware

TypeDescription = AnyDict
"""As `type_description_interfaces/msg/TypeDescription`, without default values."""

# Numbers of type_description_interfaces/msg/FieldType; a `char` of a .msg is a uint8 in IDL.
_NUMBERS = {
    "int8": 2,
    "uint8": 3,
    "char": 3,
    "int16": 4,
    "uint16": 5,
    "int32": 6,
    "uint32": 7,
    "int64": 8,
    "uint64": 9,
    "float32": 10,
    "float64": 11,
    "bool": 15,
    "byte": 16,
}
_NESTED, _STRING, _BOUNDED_STRING = 1, 17, 21
_FIXED, _BOUNDED, _UNBOUNDED = 48, 96, 144


def described(struct: Struct) -> TypeDescription:
    """Return the description of a type, with those of its parts, sorted by name."""
    parts: AnyDict = {}
    own = _individual(struct, parts)
    parts.pop(struct.name, None)
    return {
        "type_description": own,
        "referenced_type_descriptions": [parts[name] for name in sorted(parts)],
    }


def rihs01(description: TypeDescription) -> bytes:
    """Return the SHA-256 of a description's canonical JSON, 32 bytes: RIHS01 of REP-2011."""
    return hashlib.sha256(json.dumps(description).encode()).digest()


def _individual(struct: Struct, parts: AnyDict) -> AnyDict:
    fields = [{"name": n, "type": _field(kind, parts)} for n, kind in struct.fields.items()]
    return {"type_name": struct.name, "fields": fields}


def _field(kind: TypeRef, parts: AnyDict) -> AnyDict:
    offset = capacity = 0
    if isinstance(kind, Array):
        capacity = kind.most or 0
        offset = _FIXED if kind.length is not None else _BOUNDED if kind.bound else _UNBOUNDED
        kind = kind.item
    bound, nested = 0, ""
    if isinstance(kind, Primitive):
        number = _NUMBERS[kind.name]
    elif isinstance(kind, String):
        bound = kind.bound
        number = _BOUNDED_STRING if bound else _STRING
    else:
        assert isinstance(kind, Struct)
        number, nested = _NESTED, kind.name
        if nested not in parts:
            parts[nested] = _individual(kind, parts)
    return {
        "type_id": offset + number,
        "capacity": capacity,
        "string_capacity": bound,
        "nested_type_name": nested,
    }


_ANY_C, _FAST_C = b"rosidl_typesupport_c", b"rosidl_typesupport_fastrtps_c"
_MEMBERS_C = b"rosidl_typesupport_introspection_c"
_POINTER = ctypes.c_void_p


def bytes_class(name: str, messages: Messages) -> Any:
    """Return the class of a type `pkg/msg/Name` to publish and take it with, as bytes.

    Args:
        name: the type.
        messages: has its definition.

    Returns:
        The installed class; else one made of the definition, whose instances cannot be made; None
        where the type is not known, or the middleware needs generated code.
    """
    installed = message_class(name)
    if installed is not None:
        return installed
    try:
        description = described(messages.struct(name))
    except MapError:
        return None
    digest = rihs01(description)
    made = _made.get((name, digest))
    if made is None:
        template = _template()
        if template is None:
            return None
        # Kept for good: the middleware holds on to what it was given.
        made = _made[name, digest] = _class(name, description, digest, template)
    return made


def _structure(name: str, /, **fields: Any) -> Any:
    """Return a C structure: its fields' names and types, in their order."""
    return type(name, (ctypes.Structure,), {"_fields_": [*fields.items()]})


_CHARS, _SIZE = ctypes.c_char_p, ctypes.c_size_t
_FOLLOWING = _POINTER * 8  # NULL: what a newer release may add, such as keys

_Support = _structure(
    "rosidl_message_type_support_t",
    **dict.fromkeys(("identifier", "data", "find", "hash", "description", "sources"), _POINTER),
    following=_FOLLOWING,
)
_NAMES = {"namespace": _CHARS, "name": _CHARS}
_Callbacks = _structure(
    "message_type_support_callbacks_t",
    **_NAMES,
    **dict.fromkeys(("serialize", "deserialize", "size", "max_size"), _POINTER),
    following=_FOLLOWING,
)
# Of a message with no field. Fast DDS makes a type object of it, which it keeps to itself.
_Members = _structure(
    "rosidl_typesupport_introspection_c__MessageMembers",
    **_NAMES,
    count=ctypes.c_uint32,
    following=_FOLLOWING,
)
_Hash = _structure("Hash", version=ctypes.c_uint8, value=ctypes.c_uint8 * 32)
_Text = _structure("Text", data=_CHARS, size=_SIZE, capacity=_SIZE)
_Sequence = _structure("Sequence", data=_POINTER, size=_SIZE, capacity=_SIZE)
_FieldType = _structure(
    "FieldType",
    type_id=ctypes.c_uint8,
    capacity=ctypes.c_uint64,
    string_capacity=ctypes.c_uint64,
    nested_type_name=_Text,
)
_Field = _structure("Field", name=_Text, type=_FieldType, default=_Text)
_Individual = _structure("Individual", type_name=_Text, fields=_Sequence)
_Description = _structure("Description", type=_Individual, referenced=_Sequence)

_FIND = ctypes.CFUNCTYPE(_POINTER, _POINTER, ctypes.c_char_p)
_TELL = ctypes.CFUNCTYPE(_POINTER, _POINTER)
_made: dict[tuple[str, bytes], Any] = {}


class _Template(NamedTuple):
    """What is taken from an installed type: addresses of identifiers and functions."""

    any_c: int
    fast_c: int
    members_c: int
    functions: tuple[int, ...]


@cache
def _template() -> _Template | None:
    """Return what is taken from std_msgs/String.

    None where the middleware is another one, or what is there is not laid out as known.
    """
    try:
        from std_msgs.msg import String

        if not _known_middleware():
            return None
        kind = type(String)
        if kind._TYPE_SUPPORT is None:
            kind.__import_type_support__()
        address = _python("PyCapsule_GetPointer", _POINTER, ctypes.py_object, ctypes.c_char_p)
        at = address(kind._TYPE_SUPPORT, None)
        support = _pointers(at, 3)
        find = _FIND(support[2])
        fast, members = (_pointers(find(at, name), 2) for name in (_FAST_C, _MEMBERS_C))
        functions = _pointers(fast[1], 6)
        told = [ctypes.cast(each, ctypes.c_char_p).value for each in (support[0], *functions[:2])]
    except (ImportError, AttributeError, TypeError, ValueError):
        return None
    if told != [_ANY_C, b"std_msgs::msg", b"String"]:
        return None
    return _Template(support[0], fast[0], members[0], functions[2:])


def _known_middleware() -> bool:
    """Tell whether the middleware is rmw_fastrtps_cpp upon Fast DDS 2."""
    # Kilted's Fast DDS 3 tells peers the type object, which would have to be a whole one.
    older = fast_dds_profiles() == "FASTRTPS_DEFAULT_PROFILES_FILE"
    return older and middleware() == "rmw_fastrtps_cpp"


def _pointers(at: int, count: int) -> tuple[int, ...]:
    if not at:
        raise ValueError("a type support lacks a part")
    return tuple(ctypes.cast(at, ctypes.POINTER(_POINTER * count)).contents)


def _python(name: str, result: Any, *arguments: Any) -> Callable[..., Any]:
    return ctypes.PYFUNCTYPE(result, *arguments)((name, ctypes.pythonapi))


def _class(name: str, description: Any, digest: bytes, template: _Template) -> Any:
    package, _, short = name.split("/")
    keep: list[Any] = []

    def text(words: str) -> Any:
        raw = words.encode()
        keep.append(raw)
        return _Text(raw, len(raw), len(raw) + 1)

    def sequence(kind: Any, items: list[Any]) -> Any:
        array = (kind * len(items))(*items)
        keep.append(array)
        return _Sequence(ctypes.addressof(array) if items else None, len(items), len(items))

    def field(each: Any) -> Any:
        kind = each["type"]
        nested = text(kind["nested_type_name"])
        numbers = kind["type_id"], kind["capacity"], kind["string_capacity"]
        return _Field(text(each["name"]), _FieldType(*numbers, nested), text(""))

    def individual(each: Any) -> Any:
        fields = sequence(_Field, [field(one) for one in each["fields"]])
        return _Individual(text(each["type_name"]), fields)

    def teller(structure: Any) -> Any:
        at = ctypes.addressof(structure)
        function = _TELL(lambda _: at)
        keep.extend((structure, function))
        return ctypes.cast(function, _POINTER)

    parts = [individual(each) for each in description["referenced_type_descriptions"]]
    whole = _Description(individual(description["type_description"]), sequence(_Individual, parts))
    callbacks = _Callbacks(f"{package}::msg".encode(), short.encode(), *template.functions)
    members = _Members(f"{package}__msg".encode(), short.encode(), 0)
    rest = (teller(_Hash(1, (ctypes.c_uint8 * 32)(*digest))), teller(whole), teller(_Sequence()))
    found: dict[bytes, int] = {}
    find = _FIND(lambda _, identifier: found.get(identifier))
    keep += [callbacks, members, find]

    def support(identifier: int, data: Any) -> int:
        at = ctypes.addressof(data) if data is not None else None
        keep.append(_Support(identifier, at, ctypes.cast(find, _POINTER), *rest))
        return ctypes.addressof(keep[-1])

    found[_FAST_C] = support(template.fast_c, callbacks)
    found[_MEMBERS_C] = support(template.members_c, members)
    found[_ANY_C] = support(template.any_c, None)
    capsule = _python("PyCapsule_New", ctypes.py_object, _POINTER, ctypes.c_char_p, _POINTER)

    def refuse(self: Any, *_: Any, **__: Any) -> None:
        raise TypeError(f"{name} goes as bytes only: the ROS package {package} is not installed")

    # rclpy wants the other four to be there, and looks into them for a message that is not bytes.
    unused = dict.fromkeys(
        ("_CREATE_ROS_MESSAGE", "_CONVERT_FROM_PY", "_CONVERT_TO_PY", "_DESTROY_ROS_MESSAGE"), ""
    )
    given = {"_TYPE_SUPPORT": capsule(found[_ANY_C], None, None), "_keep": keep}
    meta = type(f"Metaclass_{short}", (type,), {**unused, **given})
    return meta(short, (), {"__init__": refuse, "__slots__": (), "__module__": f"{package}.msg"})
