"""A Livox Mid-360's datagrams as bytes, both ways: no sockets, no waiting.

After "Livox LiDAR Communication Protocol - Mid360" v1.4.11 (livox-wiki-en.readthedocs.io), which
has ports, headers, keys, return codes and both checksums; all is little endian.
"""

from __future__ import annotations

import binascii
import math
import struct
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from unicon_base.located_yaml import read_yaml
from unicon_hardware.wire import frame_type

HEAD = 36
"""Bytes before the samples of a datagram of points or of the IMU."""
_HEAD = struct.Struct("<BHHHHBBB12xIQ")
DATA = 24
"""Bytes before the data of a command."""
_COMMAND = struct.Struct("<BBHIHBB6xHI")
LARGEST = 1400
"""Bytes of a command."""

POINTS = 96
"""Most points of a datagram."""
IMU = 0
"""The type of a datagram of the IMU: turning in [rad/s] and acceleration in [g], once."""
_SENSOR = struct.Struct("<6f")

SAMPLES = {
    1: frame_type("x <i4, y <i4, z <i4, reflectivity u1, tag u1"),
    2: frame_type("x <i2, y <i2, z <i2, reflectivity u1, tag u1"),
    3: frame_type("depth <u4, theta <u2, phi <u2, reflectivity u1, tag u1"),
}
"""Types of points: x, y, z in [mm] and in [cm]; depth in [mm], zenith and azimuth in [0.01 deg]."""

REQUEST, ACK = 0, 1
_HOST, _LIDAR = 0, 1
CONFIGURE, INQUIRE = 0x0100, 0x0101

_WORDS = read_yaml(Path(__file__).with_name("words.yaml")).value
STATES: Mapping[int, str] = _WORDS["states"]
"""Of a scanner, key 0x8006."""

RETURNS: Mapping[int, str] = _WORDS["returns"]


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
