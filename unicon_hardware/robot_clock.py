"""The robot's own clock beside ours, and frames that come again: for wires of robots.

A robot that counts milliseconds in its frames tells when it measured. `RobotClock` makes the stamp
of it, and finds frames that get older all the while. `Repeats` finds measurements that have been
there before, under whichever count.
"""

from __future__ import annotations

import time
from collections import deque

from unicon_base import Fault
from unicon_hardware.wire import ahead


class RobotClock:
    """Compares a robot's clock of 1 ms and 32 bits with `time.monotonic_ns`.

    How long a frame was on its way nobody knows; the quickest one is the measure, and others are
    older by so much. The measure follows the robot's clock where that is slower than ours by up to
    `DRIFT`, and forgives what a silence of the robot explains. A clock is believed once it has kept
    step with ours for `SETTLES`; one that counts something else never is.

    Args:
        label: of the platform, for messages.

    Attributes:
        believed: whether frames that get older are found, and stamps are the robot's.
    """

    OLD = 0.1
    """Older by so much than the quickest one is a fault, [s]: a network may be 0.02 s late."""
    DRIFT = 0.02
    """Share by which the clocks may differ; crystals do by 0.0001."""
    SETTLES = 0.5
    """In [s]."""
    STEADY = 0.03
    """Frames that are older by no more than that keep step, [s]."""
    PAUSE = 0.05
    """Without a frame for so long, [s], the robot, or this machine, stood still."""

    def __init__(self, label: str) -> None:
        self._label = label
        self.believed = False
        self._count = self._measured = self._taken = self._best = self._steady = 0
        self._offset = self._old = 0
        self._begun = False

    def __call__(self, now: int, count: int) -> int:
        """Return when a frame was measured, on our clock in [ns].

        Args:
            now: when it was taken, of `time.monotonic_ns`.
            count: of the robot, [ms].

        Raises:
            Fault: it is older than it should be, and so was the one before.
        """
        if not self._begun:
            self._begun = True
            self._taken = self._steady = self._best = self._offset = now
            self._count = count
            return now
        self._measured += ahead(count, self._count) * 1_000_000
        gap, before = now - self._taken, self._offset
        self._count, self._taken = count, now
        offset = self._offset = now - self._measured
        best = self._best + round(self.DRIFT * gap)
        if gap > self.PAUSE * 1e9:
            best += max(offset - before, 0)
        self._best = min(best, offset)
        age = offset - self._best
        if not self.believed:
            if age > self.STEADY * 1e9:
                self._steady, self._best = now, offset
            self.believed = now - self._steady > self.SETTLES * 1e9
            return now
        self._old = self._old + 1 if age > self.OLD * 1e9 else 0
        if self._old > 1:
            raise Fault(
                f"{self._label}: what the robot measured is {age * 1e-9:.2f} s older than it was, "
                "by its own clock, and frames go on coming; is something between it and this "
                "machine queueing them?"
            )
        return now - age


class Repeats:
    """Finds measurements that come a second time, each once more behind the other.

    Args:
        label: of the platform, for messages.
        span: of a frame's bytes: measurements, without counts and checksums.
    """

    LASTS = 0.2
    """So long they have to come again, [s]."""
    LEAST = 5
    """So many frames at least."""
    KEPT = 5000
    """Frames that are remembered: 10 s at 500 Hz."""

    def __init__(self, label: str, span: slice) -> None:
        self._label, self._span = label, span
        self._seen: dict[int, int] = {}
        self._order: deque[int] = deque()
        self._last = self._number = self._run = self._since = 0

    def __call__(self, raw: bytes) -> None:
        """Look at a frame.

        Raises:
            Fault: what it measures was there before, and so were those in front of it.
        """
        key = hash(raw[self._span])
        if key == self._last:  # it stands still, which is another matter
            return
        self._last = key
        self._number += 1
        before = self._seen.get(key)
        if before is not None and self._number - before > self.LEAST:
            if not self._run:
                self._since = time.monotonic_ns()
            self._run += 1
            lasted = (time.monotonic_ns() - self._since) * 1e-9
            if self._run > self.LEAST and lasted > self.LASTS:
                raise Fault(
                    f"{self._label}: the robot's measurements repeat: for {lasted:.1f} s they have "
                    f"been those of {self._number - before} frames before"
                )
        else:
            self._run //= 2  # one may have been lost the first time
        self._seen[key] = self._number
        self._order.append(key)
        if len(self._order) > self.KEPT:
            old = self._order.popleft()
            if self._seen.get(old, self._number) <= self._number - self.KEPT:
                del self._seen[old]
