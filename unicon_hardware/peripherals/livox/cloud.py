"""Clouds: gathers datagrams of points and lays them out as messages, a tenth of a second each.

Points are gathered as they came; all of a cloud's are converted at once: 96 at a time cost ten
times as much.
"""

from __future__ import annotations

import math
import time

import numpy as np
from numpy.typing import NDArray

from unicon_base.arrays import Bool
from unicon_core.handles import FrameRing
from unicon_hardware.peripherals.livox.protocol import HEAD, POINTS, SAMPLES, Packet
from unicon_hardware.wire import frame_type
from unicon_ros.bridge.images import FrameMessage, cloud_message

FRAME_NS = 100_000_000
PACKETS = 212
"""Most datagrams of a cloud: 2083.3 a second, and some to spare."""
ROW = 1408
"""Bytes that are kept of each; the longest has 1380."""
LINES = 4
"""Lasers of a Mid-360, which take turns (livox_ros_driver2: line_num)."""
JUMP_NS = 1_000_000_000
"""The scanner's clock was set where it moves so far between two datagrams."""
WINDOW_NS = 5_000_000_000

# x, y, z in [m]; reflectivity 0 to 255; the tag's bits; laser; time after the stamp in [ns].
_POINT = "x <f4, y <f4, z <f4, intensity <f4, tag u1, line u1, offset_time <u4"
POINT = np.dtype(frame_type(_POINT).descr, align=True)


def livox_message(frame_id: str) -> FrameMessage:
    """Return the layout of a cloud."""
    return cloud_message(PACKETS * POINTS, POINT, frame_id)


class SensorClock:
    """Tells by CLOCK_MONOTONIC what a scanner's clock says: the quickest way of late is the truth.

    A datagram that waited, here or on its way, changes nothing. Clocks may drift by 1e-4: the least
    of the last 5 to 10 s is taken.
    """

    def __init__(self) -> None:
        self._last = self._began = 0
        self._offset = self._next = 0
        self.set = False

    def hear(self, stamp_ns: int, now_ns: int) -> bool:
        """Take note of a datagram; False where the scanner's clock was set.

        Args:
            stamp_ns: by its clock.
            now_ns: by ours.
        """
        late = now_ns - stamp_ns
        jumped = self.set and not -JUMP_NS < stamp_ns - self._last < JUMP_NS
        if jumped or not self.set:
            self._offset = self._next = late
            self._began, self.set = now_ns, True
        elif late < self._next:
            self._next = late
            self._offset = min(self._offset, late)
        if now_ns - self._began > WINDOW_NS:
            self._offset, self._next, self._began = self._next, late, now_ns
        self._last = stamp_ns
        return not jumped

    def at(self, stamp_ns: int) -> int:
        """Return the time by our clock, [ns]."""
        return stamp_ns + self._offset


class Counter:
    """Counts the datagrams that did not come, by the numbers of those that did.

    Numbers begin at 0 again at the beginning of a scanner's own frame, or after 65,535.

    Attributes:
        lost: how many.
    """

    def __init__(self) -> None:
        self.lost = 0
        self._next = -1

    def hear(self, count: int) -> None:
        """Take note of a number."""
        if count != self._next and self._next >= 0:
            gap = (count - self._next) & 0xFFFF
            # Far ahead is behind: the numbers have begun again, and `count` have not come since.
            self.lost += gap if gap < 0x8000 else count
        self._next = (count + 1) & 0xFFFF

    def begin(self) -> None:
        """Forget the last number: what came meanwhile is not known."""
        self._next = -1


class Clouds:
    """Fills a ring with clouds.

    Args:
        ring: of `livox_message`.
        message: that layout.

    Attributes:
        row: where to receive the next datagram.
    """

    def __init__(self, ring: FrameRing, message: FrameMessage) -> None:
        self._ring, self._message = ring, message
        self._raw = np.zeros((PACKETS + 1, ROW), np.uint8)
        self._rows = [row.data for row in self._raw]
        self._stamps = np.zeros(PACKETS, np.int64)
        self._steps = np.zeros(PACKETS)
        self._points = np.zeros(PACKETS, np.int64)
        self._number, self._kind = 0, -1
        self.row = self._rows[0]

    @property
    def newest(self) -> bytes:
        """The newest cloud's message; empty before there is one."""
        frame = self._ring.frame(self._ring.latest)
        return b"" if frame is None else frame.tobytes()

    def take(self, head: Packet, clock: SensorClock) -> bool:
        """Take the datagram that is in `row`; True where a cloud has become ready.

        Args:
            head: its own.
            clock: that knows it.
        """
        number, ready = self._number, False
        if number:
            age = head.stamp_ns - int(self._stamps[0])
            ready = head.kind != self._kind or number == PACKETS or not 0 <= age < FRAME_NS
            if ready:
                self.finish(clock)
                self._raw[0] = self._raw[number]
                number = 0
        self._kind = head.kind
        self._stamps[number] = head.stamp_ns
        self._steps[number] = head.interval_ns / max(head.points - 1, 1)
        self._points[number] = head.points
        self._number = number + 1
        self.row = self._rows[self._number]
        return ready

    def finish(self, clock: SensorClock) -> None:
        """Write what was gathered as the next frame of the ring."""
        number, message = self._number, self._message
        self._number = 0
        if not number:
            return
        slot = self._ring.fill()
        end = len(message.template) - message.offset - PACKETS * POINTS * POINT.itemsize
        slot[: message.offset] = np.frombuffer(message.template, np.uint8, message.offset)
        slot[len(slot) - end :] = np.frombuffer(message.template[-end:], np.uint8)
        out = message.data(slot.data).reshape(PACKETS, POINTS)
        self._convert(out[:number], number)
        rest = out[number:]
        for axis in "xyz":
            rest[axis] = math.nan
        for name in ("intensity", "tag", "line", "offset_time"):
            rest[name] = 0
        stamp = clock.at(int(self._stamps[0]))
        message.stamp(slot.data, time.time_ns() - time.monotonic_ns() + stamp)
        self._ring.commit(stamp)

    def _convert(self, out: NDArray[np.void], number: int) -> None:
        sample = SAMPLES[self._kind]
        raw = np.ndarray((number, POINTS), sample, self._raw, HEAD, (ROW, sample.itemsize))
        with np.errstate(invalid="ignore"):
            missing = self._place(out, raw)
        if int(self._points[:number].min()) < POINTS:
            missing |= np.arange(POINTS) >= self._points[:number, None]
        for axis in "xyz":
            out[axis][missing] = math.nan
        out["intensity"] = raw["reflectivity"]
        out["tag"] = raw["tag"]
        out["line"] = np.arange(POINTS, dtype=np.uint8) % LINES
        after = self._stamps[:number] - self._stamps[0]
        out["offset_time"] = after[:, None] + self._steps[:number, None] * np.arange(POINTS)

    def _place(self, out: NDArray[np.void], raw: NDArray[np.void]) -> Bool:
        """Write x, y, z; return where there is none: a point without an echo is at distance 0."""
        missing: Bool
        if self._kind == 3:
            depth = 1e-3 * raw["depth"]
            theta, phi = (np.radians(0.01 * raw[angle]) for angle in ("theta", "phi"))
            across = depth * np.sin(theta)
            out["x"], out["y"] = across * np.cos(phi), across * np.sin(phi)
            out["z"] = depth * np.cos(theta)
            missing = raw["depth"] == 0
            return missing
        scale = 1e-3 if self._kind == 1 else 1e-2
        for axis in "xyz":
            np.multiply(raw[axis], scale, out=out[axis], casting="unsafe")
        missing = (raw["x"] == 0) & (raw["y"] == 0) & (raw["z"] == 0)
        return missing
