"""Message maps that drivers make of a robot file, and checks of the frames that they read."""

from __future__ import annotations

import json
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, TypeAlias

import numpy as np

from unicon_base import AnyDict, AnyMapping
from unicon_base.arrays import Array
from unicon_base.schema.marks import Text, Within
from unicon_core.states import States
from unicon_core.states.standard import COMMAND_STATES
from unicon_hardware.dds.participant import LARGEST_DOMAIN
from unicon_hardware.facts import Rate, Transport
from unicon_hardware.wire import Counts, frame_type
from unicon_msgs_map import (
    Decoder,
    Encoder,
    FieldSpec,
    MessageMap,
    PublishSpec,
    SubscribeSpec,
    parse_map,
)
from unicon_msgs_map.codec.binding import unitree_crc
from unicon_msgs_map.layout.messages import Struct, shared_messages
from unicon_msgs_map.layout.paths import Reference, parse_path
from unicon_msgs_map.layout.walker import static_size

HEADER = b"\x00\x01"
"""Plain CDR (XCDR1), little endian: all that these robots send. XCDR2 has other sizes."""
PADDING = 3
"""Bytes to a multiple of 4 that may follow a message, without being told."""


class Frames:
    """Messages of one type: header, length and checksum looked at, then read into arrays.

    Args:
        message: how they are read, and what is checked.
        arrays: what they are read into.
        counts: gets what is refused.
        size: with the header, in bytes; of a type with sequences or texts 0 leaves it to decoding.

    Raises:
        MapStateError: arrays and mapping do not fit.
    """

    def __init__(self, message: Message, arrays: Arrays, counts: Counts, size: int = 0) -> None:
        self._counts, self._checked = counts, message.checked
        self._decoder = Decoder.build(message.subscribe(arrays), arrays)
        if message.orientation:
            self._decoder.need_orientation(message.orientation)
        struct = message.struct
        self._lengths = {offset_of(struct, key): (key, n) for key, n in message.lengths.items()}
        body = static_size(struct, 0)
        self.size = size if body is None else 4 + body
        self._least = self.size or max(self._lengths, default=0) + 4
        if self._checked:
            self._buffer = bytearray(self.size)
            field = FieldSpec("crc", parse_path("crc"), Reference("const", value=0))
            self._crc = unitree_crc(field, struct, self._buffer)

    def good(self, raw: bytes) -> bool:
        """Tell whether header, length and checksum are right; count what is not."""
        if raw[:2] != HEADER:
            self._counts.refuse("not little-endian XCDR1", f"header {raw[:4].hex()}")
            return False
        for at, (name, wanted) in self._lengths.items():
            found = int.from_bytes(raw[at : at + 4], "little")
            if len(raw) >= at + 4 and found != wanted:
                self._counts.refuse(f"another length of {name}", f"{found}, not {wanted}")
                return False
        if len(raw) < self._least or (self.size and len(raw) > self.size + PADDING):
            reason = "short" if len(raw) < self._least else "long"
            self._counts.refuse(reason, f"{len(raw)} bytes, not {self._least}")
            return False
        if self._checked:
            self._buffer[4:] = raw[4 : self.size]
            crc, said = self._crc(), int.from_bytes(raw[self.size - 4 : self.size], "little")
            if crc != said:
                self._counts.refuse("wrong CRC", f"{said:08x}, not {crc:08x}")
                return False
        return True

    def read(self, raw: bytes) -> bool:
        """Read a good message into the arrays; where it is refused nothing is written."""
        if self._decoder.decode(raw):
            return True
        self._counts.refuse("impossible values", self._decoder.last_error)
        return False


def offset_of(message: Struct, name: str) -> int:
    """Return where a field stands in a frame, of 4-byte alignment, behind what has one size.

    Of a sequence it is where its length stands.
    """
    at = 0
    for key, kind in message.fields.items():
        if key == name:
            break
        size = static_size(kind, at % 8)
        assert size is not None
        at += size
    return 4 + at + -at % 4


Arrays: TypeAlias = Mapping[str, Array]
Domain = Annotated[int, Within(0, LARGEST_DOMAIN)]

COMMANDS = {
    "q": "joint_pos_target",
    "dq": "joint_vel_target",
    "tau": "joint_effort_ff",
    "kp": "joint_stiffness",
    "kd": "joint_damping",
}
"""Field of MotorCmd, which Unitree, PND and Dobot call the same, to state."""
MEASURED = {"q": "joint_pos", "dq": "joint_vel", "tau_est": "joint_effort"}
"""Field of MotorState to state."""
IMU = {
    "imu_state.quaternion": "base_quat",
    "imu_state.gyroscope": "base_ang_vel",
    "imu_state.accelerometer": "base_lin_acc",
}
"""Path of a field of IMUState to state."""


def arrays_of(states: States) -> dict[str, Array]:
    """Return the states for maps: error codes of motors, 32 bits, are read without their sign."""
    arrays = {name: states[name] for name in states}
    if "motor_error" in arrays:
        arrays["motor_error"] = arrays["motor_error"].view(np.uint32)
    return arrays


def command_arrays(joints: int) -> dict[str, Array]:
    """Return arrays for a command, zero."""
    return {name: np.zeros(joints, np.float32) for name in COMMAND_STATES}


def zeros(fields: str) -> dict[str, Array]:
    """Return arrays that a table declares, zero: `"tick u4, modes u1 12"`, as of `frame_type`."""
    kind = frame_type(fields)
    return {name: np.zeros(kind[name].shape, kind[name].base) for name in kind.names or ()}


def motors(
    array: str, slots: Sequence[int], fields: Mapping[str, str], first: int = 0, size: int = 1
) -> dict[str, str]:
    """Return paths of motors with the part of the array that each stands for.

    Args:
        array: of motors in the message.
        slots: of neighbouring joints.
        fields: of a motor, with the array that has elements for each joint.
        first: number of the first joint.
        size: elements of the array for each joint.
    """
    made: dict[str, str] = {}
    begin = 0
    for end in range(1, len(slots) + 1):
        if end == len(slots) or slots[end] != slots[begin] + end - begin:
            run = f"{array}[{slots[begin]}:{slots[begin] + end - begin}]"
            part = f"[{size * (first + begin)}:{size * (first + end)}]"
            made |= {f"{run}.{field}": name + part for field, name in fields.items()}
            begin = end
    return made


@dataclass(frozen=True)
class Message:
    """A message on a topic: the table of its fields, of which both ends are made.

    Attributes:
        topic: of DDS.
        type: such as `unitree_go/msg/LowState`.
        fields: path in it to an array, or to what a map says of one, as its reader has it;
            left out where the array is not there.
        sent: path to what who makes it writes besides.
        taken: path to an array that only who reads it has, or to the number that must stand there.
        name: of the type in DDS, where it does not follow from `type`.
        lengths: of sequences in front of which nothing varies; others are refused.
        orientation: state of a quaternion, which must have norm 1; "" for none.
        checked: it has Unitree's checksum, which must be right.
    """

    topic: str
    type: str
    fields: AnyMapping
    sent: AnyMapping = field(default_factory=dict)
    taken: AnyMapping = field(default_factory=dict)
    name: str = ""
    lengths: Mapping[str, int] = field(default_factory=dict)
    orientation: str = ""
    checked: bool = False

    @property
    def struct(self) -> Struct:
        """Its layout."""
        return shared_messages().struct(self.type)

    def subscribe(self, known: Container[str]) -> SubscribeSpec:
        """Return how it is read into those arrays that are there."""
        return self._parsed("subscribe", _known({**self.fields, **self.taken}, known)).subscribe[0]

    def publish(self, known: Container[str]) -> PublishSpec:
        """Return how it is made of those arrays that are there."""
        fields = {path: _sent(said) for path, said in _known(self.fields, known).items()}
        return self._parsed("publish", {**self.sent, **fields}).publish[0]

    def _parsed(self, way: str, fields: AnyMapping) -> MessageMap:
        entry = {"topic": self.topic, "type": self.type, "fields": fields}
        return parse_map(json.dumps({way: [entry]}), shared_messages(), name=self.topic)

    def encoder(self, arrays: Arrays) -> Encoder:
        """Return what makes it of those arrays that are there."""
        return Encoder.build(self.publish(arrays), arrays)

    def frames(self, arrays: Arrays, counts: Counts, *, size: int = 0) -> Frames:
        """Return what reads it into those arrays that are there; `size` as of `Frames`."""
        return Frames(self, arrays, counts, size)


def _known(fields: AnyMapping, arrays: Container[str]) -> AnyDict:
    """Return the fields whose array is there, and those that must be a number."""
    return {
        path: said
        for path, said in fields.items()
        if isinstance(said, int)
        or str(said["state"] if isinstance(said, dict) else said).split("[")[0] in arrays
    }


def _sent(said: Any) -> Any:
    """Return a field the other way round."""
    scaled = isinstance(said, dict) and "scale" in said
    return {**said, "scale": 1.0 / said["scale"]} if scaled else said


class Messages:
    """Messages of robot and driver: the base of facts that have `state` and `command`.

    Attributes:
        arrays: table of the arrays of the messages that are not states, as of `zeros`; `{n}` stands
            for the number of joints, and `{twice}` for two of each.
    """

    arrays = ""

    @property
    def state(self) -> Message:
        """What the robot sends."""
        raise NotImplementedError

    @property
    def command(self) -> Message:
        """What the robot takes."""
        raise NotImplementedError

    def own(self, joints: int) -> dict[str, Array]:
        """Return the arrays of the messages that are not states, zero."""
        return zeros(self.arrays.format(n=joints, twice=2 * joints)) if self.arrays else {}

    def state_in(self, arrays: Arrays, counts: Counts) -> Any:
        """Return what reads the state into those arrays that are there."""
        return self.state.frames(arrays, counts)

    def command_in(self, arrays: Arrays, counts: Counts) -> Frames:
        """Return what reads the command, as the robot does."""
        return self.command.frames(arrays, counts)


@dataclass(frozen=True)
class DdsFacts(Transport, Messages):
    """`transport` of a robot file.

    Attributes:
        domain: of DDS.
        rate: of the state in [Hz].
        state_topic: of the state.
        command_topic: of the command.
    """

    domain: Domain
    rate: Rate
    state_topic: Text
    command_topic: Text
