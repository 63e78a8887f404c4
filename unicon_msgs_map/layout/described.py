"""A message type as ROS tells it to others: the type description and the hash of REP-2011."""

from __future__ import annotations

import hashlib
import json
from typing import Any

from unicon_msgs_map.layout.messages import Array, Primitive, String, Struct, TypeRef

TypeDescription = dict[str, Any]
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
    parts: dict[str, Any] = {}
    own = _individual(struct, parts)
    parts.pop(struct.name, None)
    return {
        "type_description": own,
        "referenced_type_descriptions": [parts[name] for name in sorted(parts)],
    }


def rihs01(description: TypeDescription) -> bytes:
    """Return the SHA-256 of a description's canonical JSON, 32 bytes: RIHS01 of REP-2011."""
    return hashlib.sha256(json.dumps(description).encode()).digest()


def _individual(struct: Struct, parts: dict[str, Any]) -> dict[str, Any]:
    fields = [{"name": n, "type": _field(kind, parts)} for n, kind in struct.fields.items()]
    return {"type_name": struct.name, "fields": fields}


def _field(kind: TypeRef, parts: dict[str, Any]) -> dict[str, Any]:
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
