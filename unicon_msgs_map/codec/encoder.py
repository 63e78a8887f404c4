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

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from unicon_base.generated import define
from unicon_msgs_map.codec.binding import Arrays, Bound, Names, Variables, bind_state, bind_variable
from unicon_msgs_map.codec.checksum import unitree_crc
from unicon_msgs_map.codec.packs import Copy, Packs, as_copy, copy_lines
from unicon_msgs_map.codec.placing import place_constant, place_state
from unicon_msgs_map.errors import MapStateError
from unicon_msgs_map.layout.template import Node, Slot, Template
from unicon_msgs_map.spec import PublishSpec


def generate(
    template: Template,
    bounds: Mapping[int, Bound],
    checksum: Callable[[], int] | None = None,
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
