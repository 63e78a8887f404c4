"""Block `livox`: clouds and IMU of a Livox Mid-360, received by a process of its own.

    commands:
      - livox: {lidar: 192.168.1.112}

A cloud is a whole sensor_msgs/PointCloud2 of 0.1 s in a `FrameRing`; the state
`livox_cloud_handle` numbers the newest.
"""

from __future__ import annotations

import binascii
import ipaddress
import math
import struct
import zlib
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np

from unicon_base.errors import WorkflowError
from unicon_base.schema.marks import Within
from unicon_core.flow import Block
from unicon_core.states import StateSpec
from unicon_core.workflow.autowire import BuildContext
from unicon_hardware.peripherals.livox.cloud import livox_message
from unicon_ros.bridge.camera_topics import RELIABILITIES, large_data, topic_options
from unicon_ros.peripheral import peripheral_block, peripheral_states

MODULE = "unicon_hardware.peripherals.livox.process"
Port = Annotated[int, Within(1024, 65535)]


def livox(
    context: BuildContext,
    *,
    lidar: str,
    host: str = "",
    point_port: Port = 56301,
    imu_port: Port = 56401,
    data_type: Literal[1, 2, 3] = 1,
    configure: bool = True,
    checksum: bool = True,
    silence: Annotated[float, Within(0.05, 10.0, "s")] = 0.2,
    frame_id: str = "livox_frame",
    prefix: str = "livox",
    topic: str = "",
    reliability: str = RELIABILITIES[0],
    node: str = "",
    namespace: str | None = None,
    ros_args: Sequence[str] = (),
) -> Block:
    """Write the newest cloud's handle and the IMU of a Mid-360.

    Args:
        context: of the workflow.
        lidar: address of the scanner: 192.168.1.1 and the last two digits of its serial number.
        host: address of this computer; the one on the way to the scanner if empty.
        point_port: of this computer; another one for each scanner.
        imu_port: of this computer; another one for each scanner.
        data_type: of the points: 1 in [mm], 2 in [cm] and shorter, 3 spherical.
        configure: tell the scanner where to send; else another program has done so.
        checksum: refuse what does not fit its checksum.
        silence: without points for so long it is not there, in [s].
        frame_id: of the clouds: the scanner's own frame, x forward, y left, z up.
        prefix: stands before the names of its states.
        topic: where the clouds are published too, such as `livox/points`; nowhere if empty.
        reliability: of the topic: `reliable`, which every subscriber gets, or `best_effort`.
        node: name of the process's node; that of its states if empty.
        namespace: of that node.
        ros_args: ROS arguments of that node, such as remaps.

    Raises:
        WorkflowError: an option is wrong.
        UniconError: another program has the ports, or the topic cannot be.
        MissingDependencyError: rclpy is not installed, and a topic is given.
    """
    for label, address in (("lidar", lidar), ("host", host or "127.0.0.1")):
        try:
            ipaddress.IPv4Address(address)
        except ValueError as error:
            raise WorkflowError(
                f"livox: {label} is {address!r}; give an IPv4 address such as 192.168.1.112"
            ) from error
    if point_port == imu_port:
        raise WorkflowError(f"livox: point_port and imu_port are {imu_port}; give two ports")
    options = {
        "lidar": lidar,
        "host": host,
        "point_port": point_port,
        "imu_port": imu_port,
        "data_type": data_type,
        "configure": configure,
        "checksum": checksum,
        "silence": silence,
        "frame_id": frame_id,
        "topic": topic,
        "ros": topic_options("livox", node or prefix, namespace, ros_args, reliability),
    }
    return peripheral_block(
        context,
        prefix,
        MODULE,
        options,
        values=_values(prefix),
        frames={"cloud": livox_message(frame_id)},
        environment=large_data() if topic else None,
    )


def _values(name: str) -> Mapping[str, StateSpec]:
    return {
        f"{name}_ang_vel": StateSpec((3,), unit="rad/s", frame=name, description="turning"),
        f"{name}_lin_acc": StateSpec(
            (3,), unit="m/s²", frame=name, description="acceleration, gravity in it"
        ),
        f"{name}_lost": StateSpec((), "int64", description="datagrams that did not come"),
        f"{name}_refused": StateSpec((), "int64", description="datagrams that were not taken"),
    }


def _declares(prefix: str = "livox", **_: Any) -> Mapping[str, StateSpec]:
    return peripheral_states(prefix, _values(prefix), ["cloud"])


setattr(livox, "declares", _declares)  # noqa: B010  a function has none to mypy

# Bytes before the samples of a datagram of points or of the IMU.
HEAD = 36
_HEAD = struct.Struct("<BHHHHBBB12xIQ")
# Bytes before the data of a command.
DATA = 24
_COMMAND = struct.Struct("<BBHIHBB6xHI")
# Bytes of a command.
LARGEST = 1400

# Most points of a datagram.
POINTS = 96
# The type of a datagram of the IMU: turning in [rad/s] and acceleration in [g], once.
IMU = 0
_SENSOR = struct.Struct("<6f")

# Types of points: x, y, z in [mm] and in [cm]; depth in [mm], zenith and azimuth in [0.01 deg].
SAMPLES: Mapping[int, np.dtype[np.void]] = {
    1: np.dtype([("x", "<i4"), ("y", "<i4"), ("z", "<i4"), ("reflectivity", "u1"), ("tag", "u1")]),
    2: np.dtype([("x", "<i2"), ("y", "<i2"), ("z", "<i2"), ("reflectivity", "u1"), ("tag", "u1")]),
    3: np.dtype(
        [
            ("depth", "<u4"),
            ("theta", "<u2"),
            ("phi", "<u2"),
            ("reflectivity", "u1"),
            ("tag", "u1"),
        ]
    ),
}

REQUEST, ACK = 0, 1
_HOST, _LIDAR = 0, 1
CONFIGURE, INQUIRE = 0x0100, 0x0101

# Of a scanner, key 0x8006.
STATES = {
    1: "sampling",
    2: "idle",
    4: "error",
    5: "self-check",
    6: "motor starting",
    8: "upgrade",
    9: "ready",
}

RETURNS = {
    0x01: "failed",
    0x02: "not in its present state",
    0x03: "value out of range",
    0x20: "parameter not supported",
    0x21: "takes effect after a reboot",
    0x22: "parameter is read-only",
    0x23: "wrong length",
    0x24: "wrong number of keys",
}


class Refused(Exception):
    """A datagram that is not taken; its text says why, the same for all alike."""


class Packet(NamedTuple):
    """A datagram of points or of the IMU, taken apart.

    Attributes:
        interval_ns: from its first point to its last, [ns].
        points: how many it has.
        number: its own, which begins at 0 again.
        kind: type of its samples.
        clock: 0 since the scanner was turned on, 1 PTP, 2 GPS.
        stamp_ns: of the first point by that clock, [ns].
    """

    interval_ns: int
    points: int
    number: int
    kind: int
    clock: int
    stamp_ns: int


def packet(data: memoryview, checksum: bool = True) -> Packet:
    """Return the head of a datagram of points or of the IMU.

    Args:
        data: the whole datagram.
        checksum: compare it; it is of stamp and samples.

    Raises:
        Refused: it is none, or was damaged.
    """
    size = len(data)
    if size < HEAD:
        raise Refused("wrong length")
    version, length, interval, points, number, _, kind, clock, crc, stamp = _HEAD.unpack_from(data)
    if version != 0:
        raise Refused("wrong version")
    if kind == IMU:
        wanted, most = _SENSOR.size, 1
    elif kind in SAMPLES:
        wanted, most = SAMPLES[kind].itemsize, POINTS
    else:
        raise Refused("unknown type")
    if length != size or size != HEAD + points * wanted or not 1 <= points <= most:
        raise Refused("wrong length")
    if checksum and zlib.crc32(data[28:]) != crc:
        raise Refused("wrong checksum")
    if stamp >= 1 << 63:
        raise Refused("no time")
    return Packet(100 * interval, points, number, kind, clock, stamp)


def read_imu(data: memoryview) -> tuple[float, ...]:
    """Return turning in [rad/s] and acceleration in [g] of the IMU's datagram, 3 each.

    Raises:
        Refused: they are not finite.
    """
    values = _SENSOR.unpack_from(data, HEAD)
    if not all(map(math.isfinite, values)):
        raise Refused("not finite")
    return values


def target(address: str, port: int, source: int) -> bytes:
    """Return the value of a key that says where the scanner sends.

    Args:
        address: of this computer.
        port: of this computer.
        source: port of the scanner.
    """
    return bytes(map(int, address.split("."))) + struct.pack("<HH", port, source)


def configuration(values: Mapping[int, bytes]) -> bytes:
    """Return the data of a command that sets keys to values."""
    listed = (struct.pack("<HH", key, len(value)) + value for key, value in values.items())
    return struct.pack("<HH", len(values), 0) + b"".join(listed)


def command(number: int, what: int, data: bytes, *, answer: bool = False) -> bytes:
    """Return a command, or a scanner's answer to it.

    Args:
        number: of the exchange.
        what: CONFIGURE or INQUIRE.
        data: of it.
        answer: it is the scanner that says it.
    """
    crc = zlib.crc32(data) if data else 0
    way = (ACK, _LIDAR) if answer else (REQUEST, _HOST)
    head = _COMMAND.pack(0xAA, 0, DATA + len(data), number, what, *way, 0, crc)
    return head[:18] + struct.pack("<HI", binascii.crc_hqx(head[:18], 0xFFFF), crc) + data


def read_command(data: bytes) -> tuple[int, int, int, bytes]:
    """Return number, command, REQUEST or ACK, and the data.

    Raises:
        Refused: it is not a command, or was damaged.
    """
    if not DATA <= len(data) <= LARGEST:
        raise Refused("wrong length")
    start, version, length, number, what, way, _, crc16, crc32 = _COMMAND.unpack_from(data)
    if start != 0xAA or version != 0:
        raise Refused("wrong version")
    if length != len(data):
        raise Refused("wrong length")
    told = zlib.crc32(data[DATA:]) if length > DATA else 0
    if binascii.crc_hqx(data[:18], 0xFFFF) != crc16 or told != crc32:
        raise Refused("wrong checksum")
    return number, what, way, data[DATA:]


def read_answer(data: bytes) -> str:
    """Return why a configuration was refused, empty if it was taken.

    Raises:
        Refused: it is not an answer.
    """
    if len(data) != 3:
        raise Refused("wrong length")
    code, key = struct.unpack("<BH", data)
    return f"{RETURNS.get(code, 'unknown')} (0x{code:02x}, key 0x{key:04x})" if code else ""


def read_values(data: bytes) -> dict[int, bytes]:
    """Return the keys and values of an answer to INQUIRE.

    Raises:
        Refused: it is not an answer.
    """
    if len(data) < 3 or data[0]:
        raise Refused("wrong length")
    (number,), at, values = struct.unpack_from("<H", data, 1), 3, dict[int, bytes]()
    for _ in range(number):
        if len(data) < at + 4:
            raise Refused("wrong length")
        key, size = struct.unpack_from("<HH", data, at)
        values[key] = data[at + 4 : at + 4 + size]
        at += 4 + size
    return values
