"""ModbusConnection: one exchange after the other, over TCP or a serial line; waits for answers."""

from __future__ import annotations

import fcntl
import os
import select
import socket
import struct
import termios
import time
import tty
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from unicon_base import PlatformError
from unicon_core.robots import Robot
from unicon_hardware.facts import Baud, Port, fact, port_number

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

ANSWER = 0.05
"""How long an answer may take, [s]: over RTU at 115200 baud one of 6 registers takes 3 ms."""


class Line:
    """The bytes of one connection, taken apart into frames.

    Args:
        file: its descriptor.
        framing: of its bytes.
        answers: the other side answers; else it asks.
    """

    def __init__(self, file: int, framing: Framing, *, answers: bool) -> None:
        self._file, self._framing, self._answers = file, framing, answers
        os.set_blocking(file, False)
        self._data = bytearray()

    def _readable(self, timeout: float) -> bool:
        return bool(select.select([self._file], [], [], timeout)[0])

    def _receive(self) -> None:
        """Take what has come.

        Raises:
            OSError: the connection is gone.
        """
        try:
            data = os.read(self._file, 4096)
        except BlockingIOError:
            return
        if not data:
            raise ConnectionResetError("closed by the other side")
        self._data += data

    def _next(self) -> Frame | None:
        """Return the first frame, None where there is no whole one.

        Raises:
            Refused: what has come is none.
        """
        size = self._framing.size(self._data, answer=self._answers)
        if not size or len(self._data) < size:
            return None
        frame = bytes(self._data[:size])
        del self._data[:size]
        return self._framing.unpack(frame)


class ModbusConnection(Line):
    """An open connection.

    Args:
        file: its descriptor.
        framing: of its bytes.
        close: lets go of it; called once.
    """

    def __init__(self, file: int, framing: Framing, close: Callable[[], object]) -> None:
        super().__init__(file, framing, answers=True)
        self._close, self._number = close, 0

    def exchange(self, unit: int, pdu: bytes, timeout: float = ANSWER) -> bytes:
        """Send a request; return function and data of its answer.

        Raises:
            Refused: no answer in time, or another or a damaged one.
            OSError: the connection is gone, or the other side takes nothing.
        """
        self._number = (self._number + 1) & 0xFFFF
        serial = isinstance(self._framing, Rtu)
        end = time.monotonic() + timeout
        self._drain()
        self._send(self._framing.pack(Frame(self._number, unit, pdu)), end)
        while True:
            frame = self._next()
            # One with an older number answers a request that was given up.
            if frame is not None and (serial or frame.number == self._number):
                if frame.unit != unit:
                    raise Refused("answer of another unit", f"{frame.unit}, asked was {unit}")
                return frame.pdu
            left = end - time.monotonic()
            if left <= 0.0 or (frame is None and not self._readable(left)):
                got = f"{len(self._data)} bytes in {timeout:g} s"
                raise Refused("short" if self._data else "no answer", got)
            if frame is None:
                self._receive()

    def read(self, unit: int, start: int, count: int, timeout: float = ANSWER) -> Registers:
        """Return `count` holding registers from `start`; errors as of `exchange`."""
        return read_answer(self.exchange(unit, read_request(start, count), timeout), count)

    def write(self, unit: int, start: int, values: Registers) -> None:
        """Write holding registers from `start`; errors as of `exchange`."""
        write_answer(self.exchange(unit, write_request(start, values)), start, len(values))

    def close(self) -> None:
        """Let go, once: the number of a closed file may be another one's by now."""
        close, self._close = self._close, lambda: None
        close()

    def _send(self, data: bytes, end: float) -> None:
        while data:
            with suppress(BlockingIOError):
                data = data[os.write(self._file, data) :]
                continue
            left = end - time.monotonic()
            if left <= 0.0 or not select.select([], [self._file], [], left)[1]:
                # Half a request may have left: only a new connection begins at one.
                raise TimeoutError("the other side takes nothing")

    def _drain(self) -> None:
        """Forget what came too late, or unasked."""
        for _ in range(16):
            self._data.clear()
            if not self._readable(0.0):
                return
            self._receive()
        self._data.clear()


def open_tcp(address: str, port: int) -> ModbusConnection:
    """Connect.

    Raises:
        OSError: nobody listens there.
    """
    connection = socket.create_connection((address, port), timeout=1.0)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return ModbusConnection(connection.fileno(), Tcp(), connection.close)


def open_serial(device: str, baudrate: int) -> ModbusConnection:
    """Open a serial line, 8N1, for this process alone.

    Raises:
        OSError: it is not there, or another process has it.
        PlatformError: it has no such baud rate.
    """
    speed = getattr(termios, f"B{baudrate}", None)
    if speed is None:
        raise PlatformError(f"serial line {device}: no baud rate {baudrate}; usual is 115200")
    # Else it waits for a modem's carrier, which a hand has not.
    file = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        tty.setraw(file)
        settings = termios.tcgetattr(file)
        settings[2] = termios.CS8 | termios.CREAD | termios.CLOCAL
        settings[4] = settings[5] = speed
        termios.tcsetattr(file, termios.TCSANOW, settings)
        termios.tcflush(file, termios.TCIOFLUSH)
    except termios.error as error:
        os.close(file)
        raise OSError(f"is not a serial line: {error}") from error
    except OSError:
        os.close(file)
        raise
    return ModbusConnection(file, Rtu(), partial(_close_serial, file))


def _close_serial(file: int) -> None:
    """Close a line; what nobody took is forgotten, for which it would wait."""
    with suppress(termios.error):
        termios.tcflush(file, termios.TCOFLUSH)
    os.close(file)


def reached(
    robot: Robot, platform: str, address: str | None, port: int | None, device: str | None
) -> tuple[str, Callable[[], ModbusConnection]]:
    """Return where a hand is, in words, and what connects to it.

    Args:
        robot: its file, which may say `address` and `port`.
        platform: for messages.
        address: over TCP; None for the file's.
        port: over TCP; None for the file's.
        device: a serial line such as /dev/ttyUSB0, in place of TCP.

    Raises:
        PlatformError: an option is wrong, or none says where it is.
        RobotError: the robot file does not say its port or baud rate.
    """
    if device is not None:
        if address is not None or port is not None:
            raise PlatformError(
                f"platform {platform!r}: device is a serial line, and address and port are of a "
                "network; give one of them"
            )
        baudrate = fact(robot, "baudrate", Baud)
        return f"{device} ({baudrate} baud)", lambda: open_serial(device, baudrate)
    address = robot.transport.get("address") if address is None else address
    if not address:
        raise PlatformError(
            f"platform {platform!r}: where is the hand? give its serial line: platforms: "
            f"{{{platform}: {{device: /dev/ttyUSB0}}}}"
        )
    number = fact(robot, "port", Port) if port is None else port_number(port, platform)
    return f"{address}:{number}", lambda: open_tcp(str(address), number)
