"""A Mid-360 for tests, byte by byte after Livox' protocol document; shares no code with ours.

As a program: mid360_peer.py ADDRESS SECONDS, which waits to be configured, sends 2083 datagrams of
96 points and 200 of the IMU a second, and prints how many of each.
"""

from __future__ import annotations

import select
import socket
import struct
import sys
import threading
import time
import zlib
from typing import Any

RATE = 200_000 / 96


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE, bit by bit."""
    value = 0xFFFF
    for byte in data:
        value ^= byte << 8
        for _ in range(8):
            value = (value << 1 ^ 0x1021 if value & 0x8000 else value << 1) & 0xFFFF
    return value


def datagram(
    kind: int, samples: bytes, points: int, count: int, stamp_ns: int, interval: int = 4560
) -> bytes:
    """Return a datagram of points or of the IMU; the interval is in [0.1 us]."""
    tail = struct.pack("<Q", stamp_ns) + samples
    size = 28 + len(tail)
    head = b"\0" + struct.pack("<HHHH", size, interval, points, count) + bytes([0, kind, 0])
    return head + bytes(12) + struct.pack("<I", zlib.crc32(tail)) + tail


def cartesian(points: list[tuple[int, int, int, int, int]]) -> bytes:
    """Return samples of type 1: x, y, z in [mm], reflectivity, tag."""
    return b"".join(struct.pack("<iiiBB", *point) for point in points)


class Mid360:
    """Answers commands in a thread; sends what it is told to.

    Attributes:
        keys: that it was configured with.
        asked: how often it was told something.
        code: return code of its answers.
    """

    def __init__(self, address: str) -> None:
        self.address = address
        self.commands, self.points, self.imu = (self._bound(port) for port in (56100, 56300, 56400))
        self.keys: dict[int, bytes] = {}
        self.asked, self.code, self.state, self.count = 0, 0, 1, 0
        self.silent = self._closed = False
        self._thread = threading.Thread(target=self._answer, daemon=True)
        self._thread.start()

    def _bound(self, port: int) -> socket.socket:
        made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        made.bind((self.address, port))
        return made

    def _answer(self) -> None:
        while not self._closed:
            if not select.select([self.commands], [], [], 0.05)[0]:
                continue
            data, sender = self.commands.recvfrom(2048)
            start, version, length, number, what, kind, side = struct.unpack_from("<BBHIHBB", data)
            assert (start, version, length, kind, side) == (0xAA, 0, len(data), 0, 0)
            told16, told32 = struct.unpack_from("<HI", data, 18)
            assert told16 == crc16(data[:18])
            assert told32 == zlib.crc32(data[24:])
            self.asked += 1
            if self.silent:
                continue
            if what == 0x0100:
                answer = struct.pack("<BH", self.code, 0x1A if self.code else 0)
                (many,), at = struct.unpack_from("<H", data, 24), 28
                for _ in range(many):
                    key, size = struct.unpack_from("<HH", data, at)
                    if not self.code:
                        self.keys[key] = data[at + 4 : at + 4 + size]
                    at += 4 + size
                assert at == len(data)
            else:
                assert (what, data[24:]) == (0x0101, struct.pack("<HHH", 1, 0, 0x8006))
                answer = struct.pack("<BHHHB", 0, 1, 0x8006, 1, self.state)
            head = struct.pack("<BBHIHBB6x", 0xAA, 0, 24 + len(answer), number, what, 1, 1)
            head += struct.pack("<HI", crc16(head), zlib.crc32(answer))
            self.commands.sendto(head + answer, sender)

    def wants(self, key: int) -> tuple[str, int] | None:
        """Where points (0x0006) or IMU (0x0007) are to be sent to."""
        value = self.keys.get(key)
        if value is None or self.keys.get(0x1A) != b"\1":
            return None
        return ".".join(map(str, value[:4])), int.from_bytes(value[4:6], "little")

    def send(self, data: bytes) -> None:
        """Send points, or the IMU's, to where they are wanted."""
        from_, key = (self.imu, 0x0007) if data[10] == 0 else (self.points, 0x0006)
        target = self.wants(key)
        if target is not None:
            from_.sendto(data, target)

    def stream(self, seconds: float, until: Any = bool) -> tuple[int, int]:
        """Send at the real rate; return how many datagrams of points and of the IMU."""
        samples = cartesian([(1000 + i, -2000, 10 * i, i, i % 4) for i in range(96)])
        turning = struct.pack("<6f", 0.1, -0.2, 0.3, 0.0, 0.5, 1.0)
        begin = time.monotonic_ns()
        sent = turned = 0
        while (after := time.monotonic_ns() - begin) < 1e9 * seconds and not until():
            while 1e9 * sent / RATE <= after:
                stamp = 5_000_000_000 + round(1e9 * sent / RATE)
                self.send(datagram(1, samples, 96, self.count, stamp))
                self.count, sent = (self.count + 1) & 0xFFFF, sent + 1
            while 1e9 * turned / 200 <= after:
                self.send(datagram(0, turning, 1, turned & 0xFFFF, 5_000_000_000 + after))
                turned += 1
            time.sleep(0.0004)
        return sent, turned

    def close(self) -> None:
        """Be pulled out."""
        self._closed = True
        self._thread.join()
        for each in (self.commands, self.points, self.imu):
            each.close()


if __name__ == "__main__":
    peer = Mid360(sys.argv[1])
    while peer.wants(0x0006) is None:
        time.sleep(0.001)
    print(*peer.stream(float(sys.argv[2])), flush=True)
