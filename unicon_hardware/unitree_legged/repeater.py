"""Repeater: sends the last datagram again between ticks, for a robot that answers each with one.

A tick of 20 ms would hear the answer to the one before, 20 ms old, and nobody has driven these
robots at less than 500 Hz. It is this driver's dead man too: a tick that does not come is damped.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import suppress

from unicon_base.errors import Fault


class Repeater(threading.Thread):
    """A thread that repeats what was sent last, until `close`; it computes nothing.

    Args:
        send: takes a datagram.
        rate: of datagrams in [Hz].
        watchdog: so long after the last `put` it sends `damping` instead, [s].
        idle: what is sent before the first `put`; nobody has to renew it.
        damping: see `watchdog`.
    """

    def __init__(
        self,
        send: Callable[[bytes], object],
        rate: float,
        watchdog: float,
        idle: bytes,
        damping: bytes,
    ) -> None:
        super().__init__(name="unitree_legged repeater", daemon=True)
        self._send, self._interval, self._watchdog = send, 1.0 / rate, watchdog
        self._frame, self._damping = idle, damping
        self._put = 0.0
        self._ended = threading.Event()
        self._late = False

    @property
    def late(self) -> bool:
        """Whether a command did not come in time: the robot is damped from then on, for good."""
        # The tick looks too: in a process that was stopped it may go on before this thread does.
        put = self._put
        self._late |= put > 0.0 and time.monotonic() - put > self._watchdog
        return self._late

    def put(self, frame: bytes) -> None:
        """Send a datagram now, and again until the next one.

        Raises:
            Fault: it cannot be sent.
        """
        self._frame = frame
        self._put = time.monotonic()
        self._send(frame)

    def run(self) -> None:
        """Send until closed."""
        interval, due = self._interval, time.monotonic()
        while not self._ended.wait(max(0.0, due - time.monotonic())):
            now, put, late = time.monotonic(), self._put, self.late
            # Half an interval of grace: a tick at this rate sends by itself.
            if now < put + 1.5 * interval and not late:
                due = put + 1.5 * interval
                continue
            with suppress(Fault):  # the tick is told the same by its own sending
                self._send(self._damping if late else self._frame)
            due = max(due + interval, now)

    def close(self) -> None:
        """End."""
        self._ended.set()
        if self.is_alive():
            self.join()
