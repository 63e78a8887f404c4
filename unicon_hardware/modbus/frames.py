"""Modbus frames as bytes, both ways: no sockets, no waiting; for links and faces.

After the Modbus Application Protocol Specification V1.1b3 (functions 3, 6 and 16), the Messaging on
TCP/IP Implementation Guide V1.0b (the MBAP header) and Modbus over Serial Line V1.02 (RTU, CRC).
"""

from __future__ import annotations

import struct
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

READ, WRITE_ONE, WRITE = 3, 6, 16
LARGEST = 260
"""Bytes of a frame over TCP; over a serial line 256."""
_HEAD = struct.Struct(">HHHB")

Registers = NDArray[np.uint16]


class Refused(Exception):
    """A frame that is not taken.

    Args:
        reason: a few words, the same for all alike.
        detail: figures of this one.
    """

    def __init__(self, reason: str, detail: str = "") -> None:
        super().__init__(f"{reason} ({detail})" if detail else reason)
        self.reason, self.detail = reason, detail


class Frame(NamedTuple):
    """A frame taken apart: number of the exchange (0 over a serial line), unit, function, data."""

    number: int
    unit: int
    pdu: bytes


def read_request(start: int, count: int) -> bytes:
    """Return the request for `count` holding registers from `start`."""
    return struct.pack(">BHH", READ, start, count)


def write_request(start: int, values: Registers) -> bytes:
    """Return the request that writes holding registers from `start`."""
    count = len(values)
    return struct.pack(">BHHB", WRITE, start, count, 2 * count) + values.astype(">u2").tobytes()


def read_answer(pdu: bytes, count: int) -> Registers:
    """Return the registers of an answer, shape (count,).

    Raises:
        Refused: it is an exception, or another answer.
    """
    _check(pdu, READ)
    if len(pdu) != 2 + 2 * count or pdu[1] != 2 * count:
        raise Refused("wrong length", f"{len(pdu) - 2} bytes for {count} registers")
    return np.frombuffer(pdu, ">u2", count, 2).astype(np.uint16)


def write_answer(pdu: bytes, start: int, count: int) -> None:
    """Look whether an answer says that registers were written.

    Raises:
        Refused: it is an exception, or another answer.
    """
    _check(pdu, WRITE)
    if pdu[1:] != struct.pack(">HH", start, count):
        raise Refused("answer to something else", pdu[1:].hex())


def refusal(function: int, code: int) -> bytes:
    """Return the answer that refuses a request: 1 function, 2 address, 3 value."""
    return bytes((function | 0x80, code))


def _check(pdu: bytes, function: int) -> None:
    if len(pdu) == 2 and pdu[0] == function | 0x80:
        raise Refused(f"exception {pdu[1]}", f"of function {function}")
    if not pdu or pdu[0] != function:
        raise Refused("wrong function", f"{pdu[0] if pdu else 'none'}, asked was {function}")


class Tcp:
    """The MBAP header: number, protocol 0, length, unit; all big endian."""

    def pack(self, frame: Frame) -> bytes:
        """Return the bytes of a frame."""
        return _HEAD.pack(frame.number, 0, 1 + len(frame.pdu), frame.unit) + frame.pdu

    def size(self, data: bytes | bytearray, *, answer: bool) -> int:
        """Return how many bytes the first frame has, 0 where that is not told yet.

        Raises:
            Refused: this is not the beginning of a frame.
        """
        if len(data) < _HEAD.size:
            return 0
        _, protocol, length, _ = _HEAD.unpack_from(data)
        if protocol != 0 or not 2 <= length <= LARGEST - 6:
            raise Refused("not a Modbus frame", bytes(data[:8]).hex())
        return 6 + int(length)

    def unpack(self, data: bytes) -> Frame:
        """Return a whole frame taken apart."""
        number, _, _, unit = _HEAD.unpack_from(data)
        return Frame(number, unit, bytes(data[_HEAD.size :]))


class Rtu:
    """Unit in front and CRC-16 behind, its low byte first."""

    def pack(self, frame: Frame) -> bytes:
        """Return the bytes of a frame."""
        data = bytes((frame.unit,)) + frame.pdu
        return data + struct.pack("<H", crc16(data))

    def size(self, data: bytes | bytearray, *, answer: bool) -> int:
        """Return how many bytes the first frame has, 0 where that is not told yet.

        Raises:
            Refused: this is not the beginning of a frame.
        """
        if len(data) < 3:
            return 0
        function = data[1]
        if function & 0x80:
            return 5
        if function == READ:
            return 5 + data[2] if answer else 8
        if function == WRITE_ONE or (function == WRITE and answer):
            return 8
        if function == WRITE:
            return 9 + data[6] if len(data) > 6 else 0
        raise Refused("not a Modbus frame", bytes(data[:8]).hex())

    def unpack(self, data: bytes) -> Frame:
        """Return a whole frame taken apart.

        Raises:
            Refused: its bytes are damaged.
        """
        told = int.from_bytes(data[-2:], "little")
        if crc16(data[:-2]) != told:
            raise Refused("wrong CRC", f"0x{told:04x}, computed is 0x{crc16(data[:-2]):04x}")
        return Frame(0, data[0], bytes(data[1:-2]))


Framing: TypeAlias = Tcp | Rtu
"""What stands around function and data."""


def crc16(data: bytes | bytearray) -> int:
    """Return the CRC-16 of a serial line: polynomial 0xA001 (reflected), beginning with 0xFFFF."""
    crc = 0xFFFF
    for byte in data:
        crc = (crc >> 8) ^ _TABLE[(crc ^ byte) & 0xFF]
    return crc


def _entry(byte: int) -> int:
    for _ in range(8):
        byte = (byte >> 1) ^ 0xA001 if byte & 1 else byte >> 1
    return byte


_TABLE = tuple(map(_entry, range(256)))
