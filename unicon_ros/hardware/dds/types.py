"""Types for CycloneDDS, made of the message definitions that `unicon_msgs_map` has.

The names on the wire are those of ROS 2, which Unitree, PND and Dobot keep to in their IDL:
`unitree_go/msg/LowCmd` is `unitree_go.msg.dds_.LowCmd_`, final, with sequential member ids
(unitree_sdk2py/idl of unitreerobotics/unitree_sdk2_python). All octets are `byte`: declared as
`uint8`, cyclonedds 11 describes them by a type that 0.10.2, which is on the robots, does not know,
so that it crashes.
"""

from __future__ import annotations

from typing import Any

from unicon_msgs_map.layout.messages import Array, Primitive, String, Struct, TypeRef

OCTETS = ("uint8", "int8", "byte")
"""What Unitree's IDL has as octet; their .msg files call temperatures of octets signed."""


def dds_name(message: Struct) -> str:
    """Return a message's type name in DDS."""
    package, _, name = message.name.split("/")
    return f"{package}.msg.dds_.{name}_"


def dds_type(message: Struct, name: str = "") -> Any:
    """Return the class that CycloneDDS wants of a topic, an `IdlStruct`.

    Args:
        message: its layout.
        name: in DDS, where it is not as `dds_name` has it.

    Only its description is used: what is sent and received are raw bytes.
    """
    from cyclonedds.idl import annotations, make_idl_struct

    fields = {key: _member(kind) for key, kind in message.fields.items()}
    name = name or dds_name(message)
    made = make_idl_struct(name.split(".")[-1], name, fields)
    annotations.final(made)
    annotations.autoid("sequential")(made)
    return made


def _member(kind: TypeRef) -> Any:
    from cyclonedds.idl import types

    if isinstance(kind, Primitive):
        if kind.name == "bool":
            return bool
        return getattr(types, "byte" if kind.name in OCTETS else kind.name)
    if isinstance(kind, String):
        return str
    if isinstance(kind, Array):
        item = _member(kind.item)
        if kind.length is None:
            return types.sequence[item, kind.bound] if kind.bound else types.sequence[item]
        return types.array[item, kind.length]
    return dds_type(kind)
