"""V4L2: what of Linux's video devices a webcam needs, by their ioctls.

Numbers and structures are those of include/uapi/linux/videodev2.h on 64-bit little-endian machines,
their use that of the kernel's "Video for Linux API" (userspace-api/media/v4l: "Common API
Elements", "Streaming I/O (Memory Mapping)"). Fields that are not named here are reserved and 0.
"""

from __future__ import annotations

import errno
import fcntl
import mmap
import os
import select
import struct
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from unicon_base import UniconError
from unicon_ros.peripheral_process import Gone

CAPABILITY = struct.Struct("<16s32s32sIII12x")  # driver, card, bus, version, capabilities, device's
FORMAT = struct.Struct("<I4x12I152x")  # type; width, height, pixelformat, field, bytesperline, …
PARAMETERS = struct.Struct("<I6I176x")  # type; capability, mode, numerator, denominator, …
REQUEST = struct.Struct("<4IB3x")  # count, type, memory, capabilities, flags
BUFFER = struct.Struct("<5I4x2q2I4B4sIII4xIIi4x")
# index, type, bytesused, flags, field, timeval, timecode, sequence, memory, offset, length, …
INT = struct.Struct("<i")

_WRITE, _READ = 1, 2


def _number(direction: int, number: int, layout: struct.Struct) -> int:
    """Return an ioctl's number (asm-generic/ioctl.h)."""
    return direction << 30 | layout.size << 16 | ord("V") << 8 | number


QUERYCAP = _number(_READ, 0, CAPABILITY)
S_FMT = _number(_READ | _WRITE, 5, FORMAT)
REQBUFS = _number(_READ | _WRITE, 8, REQUEST)
QUERYBUF = _number(_READ | _WRITE, 9, BUFFER)
QBUF = _number(_READ | _WRITE, 15, BUFFER)
DQBUF = _number(_READ | _WRITE, 17, BUFFER)
STREAMON = _number(_WRITE, 18, INT)
STREAMOFF = _number(_WRITE, 19, INT)
S_PARM = _number(_READ | _WRITE, 22, PARAMETERS)

CAPTURE, MMAP, FIELD_NONE = 1, 1, 1
"""V4L2_BUF_TYPE_VIDEO_CAPTURE, V4L2_MEMORY_MMAP, V4L2_FIELD_NONE."""
CAN_CAPTURE, CAN_STREAM, HAS_OWN = 0x1, 0x04000000, 0x80000000
"""V4L2_CAP_VIDEO_CAPTURE, V4L2_CAP_STREAMING, V4L2_CAP_DEVICE_CAPS."""
FULL_RANGE = 1
"""V4L2_QUANTIZATION_FULL_RANGE."""
BROKEN, CLOCKS, MONOTONIC = 0x40, 0xE000, 0x2000
"""V4L2_BUF_FLAG_ERROR, …_TIMESTAMP_MASK, …_TIMESTAMP_MONOTONIC."""
BUFFERS = 4
"""That are asked for; the driver may give others."""

LOST = (errno.ENODEV, errno.ENXIO, errno.EIO, errno.ENOENT, errno.EPIPE, errno.EPROTO)
"""Of a device that was pulled out."""


class Kernel:
    """Asks Linux; tests ask another one with the same methods."""

    def open(self, path: str) -> int:
        """Open a device, which then never blocks."""
        return os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)

    def ioctl(self, file: int, number: int, data: bytearray) -> None:
        """Ask; the answer stands in the data."""
        fcntl.ioctl(file, number, data, True)

    def map(self, file: int, length: int, offset: int) -> Any:
        """Return a buffer of the driver."""
        return mmap.mmap(file, length, offset=offset)

    def wait(self, file: int, seconds: float) -> bool:
        """Wait for a filled buffer, or an error."""
        return bool(select.select([file], [], [file], seconds)[0])

    def close(self, file: int) -> None:
        """Close the device."""
        os.close(file)


@dataclass(frozen=True)
class Frame:
    """A picture as the driver has it; valid until the next `Capture.take`.

    Attributes:
        data: its bytes.
        monotonic_ns: when it was taken, [ns] of CLOCK_MONOTONIC; 0 if the driver does not tell.
        sequence: number that the driver counts.
    """

    data: memoryview
    monotonic_ns: int
    sequence: int


class Capture:
    """A device that streams into mapped buffers.

    Args:
        system: what is asked.
        path: of the device.
        size: width and height of the pictures, [pixels].
        pixels: four letters of the format, such as `YUYV`.
        rate: pictures per second.

    Attributes:
        card: the device's name.
        row: of a picture in [B], where rows have a fixed length.
        full: its colours use all of 0 to 255.
        rate: that the driver gives, or 0.0 if it does not tell.

    Raises:
        Gone: it is not there, or somebody else has it.
        UniconError: it is not a camera, or has no such pictures.
    """

    def __init__(
        self, system: Kernel, path: str, size: tuple[int, int], pixels: str, rate: float
    ) -> None:
        self._system, self._path = system, path
        try:
            self._file = system.open(path)
        except PermissionError as error:
            raise Gone(f"{path} may not be opened (sudo usermod -aG video $USER)") from error
        except OSError as error:
            raise Gone(f"{path}: {error.strerror}") from error
        self._maps: list[memoryview] = []
        self._held: bytearray | None = None
        self._streams = False
        try:
            self._check()
            self._choose(size, pixels)
            self.rate = self._pace(rate)
            self._start()
        except OSError as error:
            self.close()
            raise Gone(f"{path}: {error.strerror}") from error
        except BaseException:
            self.close()
            raise

    def _ask(self, number: int, data: bytearray) -> bytearray:
        self._system.ioctl(self._file, number, data)
        return data

    def _check(self) -> None:
        try:
            answer = self._ask(QUERYCAP, bytearray(CAPABILITY.size))
        except OSError as error:
            if error.errno in LOST:
                raise
            raise UniconError(f"webcam: {self._path} is not a video device") from error
        _, card, _, _, can, own = CAPABILITY.unpack(answer)
        self.card = card.split(b"\0")[0].decode("utf-8", "replace")
        able = own if can & HAS_OWN else can
        if not (able & CAN_CAPTURE and able & CAN_STREAM):
            raise UniconError(
                f"webcam: {self._path} ({self.card}) gives no pictures to memory; name another "
                "device: a camera has several, pictures come from the one of index 0"
            )

    def _choose(self, size: tuple[int, int], pixels: str) -> None:
        wanted = int.from_bytes(pixels.encode("ascii"), "little")
        data = bytearray(FORMAT.pack(CAPTURE, *size, wanted, FIELD_NONE, *[0] * 8))
        try:
            self._ask(S_FMT, data)
        except OSError as error:
            if error.errno != errno.EBUSY:
                raise
            raise Gone(f"{self._path} is used by another process") from error
        _, width, height, got, _, self.row, self.longest, *rest = FORMAT.unpack(data)
        self.full = rest[4] == FULL_RANGE
        if (width, height, got) != (*size, wanted):
            letters = got.to_bytes(4, "little").decode("ascii", "replace")
            raise UniconError(
                f"webcam: {self._path} ({self.card}) has no {pixels} of {size[0]} x {size[1]}; it "
                f"offers {letters} of {width} x {height}, v4l2-ctl --list-formats-ext tells all"
            )

    def _pace(self, rate: float) -> float:
        period = round(1e6 / rate)
        data = bytearray(PARAMETERS.pack(CAPTURE, 0, 0, period, 1_000_000, 0, 0))
        with suppress(OSError):  # a device that knows no rates
            self._ask(S_PARM, data)
            _, _, _, numerator, denominator, *_ = PARAMETERS.unpack(data)
            return float(denominator / numerator) if numerator else 0.0
        return 0.0

    def _start(self) -> None:
        data = self._ask(REQBUFS, bytearray(REQUEST.pack(BUFFERS, CAPTURE, MMAP, 0, 0)))
        count = REQUEST.unpack(data)[0]
        if count < 2:
            raise OSError(errno.ENOMEM, f"the driver gives {count} buffers")
        for index in range(count):
            answer = self._ask(QUERYBUF, _buffer(index))
            offset, length = BUFFER.unpack(answer)[16:18]
            self._maps.append(memoryview(self._system.map(self._file, length, offset)))
            self._ask(QBUF, _buffer(index))
        self._ask(STREAMON, bytearray(INT.pack(CAPTURE)))
        self._streams = True

    def take(self, seconds: float) -> Frame | None:
        """Return the next picture; None where none came in time, or a broken one.

        Args:
            seconds: how long to wait.

        Raises:
            Gone: the device was pulled out.
        """
        try:
            self._give_back()
            if not self._system.wait(self._file, seconds):
                return None
            data = self._ask(DQBUF, _buffer(0))
        except BlockingIOError:
            return None
        except OSError as error:
            if error.errno in LOST:
                raise Gone("it was unplugged") from error
            raise Gone(f"it failed ({error.strerror})") from error
        index, _, used, flags, _, seconds_, micros, *_, sequence, _, _, _, _, _ = BUFFER.unpack(
            data
        )
        self._held = _buffer(index)
        if flags & BROKEN or index >= len(self._maps) or used > len(self._maps[index]):
            return None
        told = flags & CLOCKS == MONOTONIC
        stamp_ns = (seconds_ * 1_000_000 + micros) * 1000 if told else 0
        return Frame(self._maps[index][:used], stamp_ns, sequence)

    def _give_back(self) -> None:
        if self._held is not None:
            held, self._held = self._held, None
            self._ask(QBUF, held)

    def close(self) -> None:
        """Stop, and let the device go."""
        with suppress(OSError):
            if self._streams:
                self._ask(STREAMOFF, bytearray(INT.pack(CAPTURE)))
        self._maps.clear()
        with suppress(OSError):
            self._system.close(self._file)


def _buffer(index: int) -> bytearray:
    values = [index, CAPTURE, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, bytes(4), 0, MMAP, 0, 0, 0, 0]
    return bytearray(BUFFER.pack(*values))
