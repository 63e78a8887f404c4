"""Encoders: state arrays in, the bytes of one ROS message out; for bridges and recorders.

Built once per topic against arrays; then `encode()` takes no argument. The function is generated
(read it in `Encoder.source`): numbers that stand alone go through one `struct` pack, arrays are
cast-copied into NumPy views of a template, and arrays at even distances, such as joint_pos,
joint_vel and joint_effort in one state buffer, share a single strided copy.
"""

from __future__ import annotations

from collections.abc import Callable

from unicon_msgs_map.codec.binding import (
    Arrays,
    Bound,
    Names,
    Variables,
    bind_state,
    bind_variable,
)
from unicon_msgs_map.codec.checksum import unitree_crc
from unicon_msgs_map.codec.emit import generate
from unicon_msgs_map.codec.placing import place_constant, place_state
from unicon_msgs_map.errors import MapStateError
from unicon_msgs_map.layout.template import Node, Template
from unicon_msgs_map.spec import PublishSpec


class Encoder:
    """Bytes of one message type from state arrays; make it with `Encoder.build`.

    Attributes:
        encode: returns the message as bytes: little-endian CDR behind its 4-byte header. Raises
            nothing: integers saturate, NaN becomes 0 in an integer field, and a finite number
            that float32 cannot hold becomes an infinity.
        size: length of every message, [B].
        source: the generated Python.
        spec: the mapping entry.
    """

    __slots__ = ("encode", "size", "source", "spec")

    encode: Callable[[], bytes]

    def __init__(
        self, spec: PublishSpec, encode: Callable[[], bytes], source: str, size: int
    ) -> None:
        self.spec = spec
        self.encode = encode
        self.source = source
        self.size = size

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
