"""A V4L2 camera for tests: answers ioctls as a driver does, and minds each field that it is asked.

Offsets and numbers are written here once more, from include/uapi/linux/videodev2.h, not taken from
what is tested. The camera is there while the file that is its path exists; files beside it say what
it gives (`short`, `broken`, `stop`), or that it is opened elsewhere (`busy`). What is asked wrongly
goes to `violations`.
"""

from __future__ import annotations

import errno
import mmap
import os
import struct
import time
from pathlib import Path
from typing import Any

import numpy as np

QUERYCAP, S_FMT, REQBUFS, QUERYBUF = 0x80685600, 0xC0D05605, 0xC0145608, 0xC0585609
QBUF, DQBUF, STREAMON, STREAMOFF, S_PARM = (
    0xC058560F,
    0xC0585611,
    0x40045612,
    0x40045613,
    0xC0CC5616,
)
YUYV, MJPG = 0x56595559, 0x47504A4D
SIZES = {(640, 480), (320, 240)}
COUNT = 3  # buffers that it gives, whatever is asked for
PAGE = mmap.ALLOCATIONGRANULARITY
PADDING = 64  # at the end of a row


def u32(data: bytearray, at: int) -> int:
    return int(struct.unpack_from("<I", data, at)[0])


def pixels(number: int, width: int, height: int) -> np.ndarray:
    """Return the n-th picture, YUYV: luma rises with the column, chroma is that of the number."""
    packed = np.empty((height, width // 2, 4), np.uint8)
    packed[..., 0] = packed[..., 2] = 16 + np.arange(width // 2) % 200
    packed[..., 1], packed[..., 3] = 128, number % 200 + 20
    return packed


def jpeg(number: int) -> bytes:
    """Return the n-th picture, MJPG."""
    return b"\xff\xd8" + bytes([number % 256]) * (1000 + number % 7) + b"\xff\xd9"


class Strict:
    """The camera."""

    def __init__(self) -> None:
        self.fds: dict[int, Path] = {}
        self.state, self.queue = "open", list[int]()
        self.number, self.begin = 0, 0.0
        self.size, self.format, self.row, self.rate = (0, 0), 0, 0, 30.0

    def mind(self, right: bool, what: str) -> None:
        if not right:
            with (self.path.parent / "violations").open("a") as file:
                file.write(what + "\n")
            raise OSError(errno.EINVAL, what)

    def flag(self, name: str) -> bool:
        return (self.path.parent / name).exists()

    def open(self, path: str) -> int:
        self.path = Path(path)
        if not self.path.exists():
            raise FileNotFoundError(errno.ENOENT, "No such file or directory")
        self.mind(not self.fds, "opened twice")
        file = os.memfd_create("camera")
        self.fds[file] = self.path
        return file

    def close(self, file: int) -> None:
        self.mind(self.state != "streams" or not self.path.exists(), "closed while it streams")
        del self.fds[file]
        os.close(file)

    def map(self, file: int, length: int, offset: int) -> Any:
        self.mind(self.state == "buffers" and length == self.length, "map of another length")
        self.mind(offset % self.span == 0 and offset // self.span < COUNT, "map at another offset")
        return mmap.mmap(file, length, offset=offset)

    def ioctl(self, file: int, number: int, data: bytearray) -> None:
        self.mind(file in self.fds, "not open")
        if not self.path.exists():
            raise OSError(errno.ENODEV, "No such device")
        self.mind(len(data) == number >> 16 & 0x3FFF, f"{number:#x} with {len(data)} B")
        names = {
            QUERYCAP: self.query, S_FMT: self.set_format, S_PARM: self.set_rate,
            REQBUFS: self.request, QUERYBUF: self.tell_buffer, QBUF: self.enqueue,
            DQBUF: self.dequeue, STREAMON: self.on, STREAMOFF: self.off,
        }  # fmt: skip
        self.mind(number in names, f"ioctl {number:#x}")
        names[number](file, data)

    def query(self, _: int, data: bytearray) -> None:
        self.mind(not any(data), "QUERYCAP with data")
        struct.pack_into("<16s32s32sIII", data, 0, b"strict", b"Strict cam", b"usb", 0x60000,
                         0x84A00001, 0x04200001)  # fmt: skip

    def set_format(self, _: int, data: bytearray) -> None:
        if self.flag("busy"):
            raise OSError(errno.EBUSY, "Device or resource busy")
        self.mind(self.state == "open", "S_FMT late")
        self.mind(u32(data, 0) == 1, "S_FMT of another type")
        self.mind(u32(data, 20) == 1, "S_FMT of interlaced fields")
        self.mind(not any(data[4:8]) and not any(data[24:]), "S_FMT with reserved fields")
        size = u32(data, 8), u32(data, 12)
        self.size = size if size in SIZES else (640, 480)
        self.format = u32(data, 16) if u32(data, 16) in (YUYV, MJPG) else YUYV
        self.row = 2 * self.size[0] + PADDING if self.format == YUYV else 0
        self.length = (2 * self.size[0] + PADDING) * self.size[1]
        self.span = -(-self.length // PAGE) * PAGE
        struct.pack_into("<6I", data, 8, *self.size, self.format, 1, self.row, self.length)
        struct.pack_into("<I", data, 48, 2)  # limited range

    def set_rate(self, _: int, data: bytearray) -> None:
        self.mind(u32(data, 0) == 1 and not any(data[4:12]) and not any(data[20:]), "S_PARM")
        wanted = u32(data, 16) / u32(data, 12)
        self.rate = min((15.0, 30.0), key=lambda each: abs(each - wanted))
        struct.pack_into("<3I", data, 4, 0x1000, 0, 1)
        struct.pack_into("<I", data, 16, int(self.rate))

    def request(self, file: int, data: bytearray) -> None:
        self.mind(self.size != (0, 0) and self.state == "open", "REQBUFS out of its turn")
        self.mind(u32(data, 0) >= 2 and u32(data, 4) == 1 and u32(data, 8) == 1, "REQBUFS")
        self.mind(not any(data[12:]), "REQBUFS with reserved fields")
        os.ftruncate(file, COUNT * self.span)
        struct.pack_into("<I", data, 0, COUNT)
        self.state = "buffers"

    def buffer(self, data: bytearray, what: str) -> int:
        self.mind(u32(data, 4) == 1 and u32(data, 60) == 1, f"{what} of another type or memory")
        self.mind(not any(data[76:]), f"{what} with reserved fields")
        self.mind(u32(data, 0) < COUNT, f"{what} of buffer {u32(data, 0)}")
        return u32(data, 0)

    def tell_buffer(self, _: int, data: bytearray) -> None:
        self.mind(self.state == "buffers", "QUERYBUF out of its turn")
        index = self.buffer(data, "QUERYBUF")
        struct.pack_into("<I", data, 64, index * self.span)
        struct.pack_into("<I", data, 72, self.length)

    def enqueue(self, _: int, data: bytearray) -> None:
        self.mind(self.state in ("buffers", "streams"), "QBUF out of its turn")
        index = self.buffer(data, "QBUF")
        self.mind(index not in self.queue, f"QBUF of {index} twice")
        self.queue.append(index)

    def on(self, _: int, data: bytearray) -> None:
        self.mind(u32(data, 0) == 1 and len(self.queue) == COUNT, "STREAMON before all are queued")
        self.state, self.begin = "streams", time.monotonic()

    def off(self, _: int, data: bytearray) -> None:
        self.mind(u32(data, 0) == 1 and self.state == "streams", "STREAMOFF out of its turn")
        self.state = "open"
        self.queue.clear()

    def wait(self, file: int, seconds: float) -> bool:
        self.mind(file in self.fds and self.state == "streams", "wait before it streams")
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if not self.path.exists() or self.due():
                return True
            time.sleep(0.002)
        return False

    def due(self) -> bool:
        return not self.flag("stop") and time.monotonic() >= self.begin + self.number / self.rate

    def dequeue(self, file: int, data: bytearray) -> None:
        self.mind(self.state == "streams" and u32(data, 4) == 1 and u32(data, 60) == 1, "DQBUF")
        if not self.queue or not self.due():
            raise BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable")
        missed = int((time.monotonic() - self.begin) * self.rate) - self.number
        self.number += 1 + max(missed, 0) if len(self.queue) < 2 else 1
        index = self.queue.pop(0)
        if self.format == YUYV:
            rows = np.zeros((self.size[1], self.row), np.uint8)
            packed = pixels(self.number, *self.size)
            rows[:, : 2 * self.size[0]] = packed.reshape(self.size[1], -1)
            raw = rows.tobytes()
        else:
            raw = jpeg(self.number)
        if self.flag("short"):
            raw = raw[len(raw) // 2 :]
        os.pwrite(file, raw, index * self.span)
        now = time.clock_gettime_ns(time.CLOCK_MONOTONIC)
        flags = 0x2001 | (0x40 if self.flag("broken") else 0)
        struct.pack_into("<5I", data, 0, index, 1, len(raw), flags, 1)
        struct.pack_into("<qq", data, 24, now // 10**9, now % 10**9 // 1000)
        struct.pack_into("<I", data, 56, self.number)
        struct.pack_into("<I", data, 64, index * self.span)
        struct.pack_into("<I", data, 72, self.length)
