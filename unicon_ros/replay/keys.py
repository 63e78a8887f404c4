"""Keys: space and arrows of a terminal, for the player."""

from __future__ import annotations

import os
import select
import sys
import threading
from collections.abc import Callable
from types import TracebackType

from unicon_ros.controls import Controls

HELP = "space: pause or go on, → ←: 5 s on or back, s: one tick, r: from the beginning, q: end"
RIGHT, LEFT = b"\x1b[C", b"\x1b[D"
LOOK = 0.2
"""How long a key is waited for before the end is looked for, in [s]."""


class Keys:
    """Reads keys in a thread while it is entered; the terminal is then as it was.

    Args:
        controls: of the run.
        seek: goes on by so many ticks.
        ticks: of an arrow.
    """

    def __init__(self, controls: Controls, seek: Callable[[int], object], ticks: int) -> None:
        self._controls, self._seek, self._ticks = controls, seek, ticks
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._read, name="keys", daemon=True)

    def __enter__(self) -> Keys:
        import termios
        import tty

        self._before = termios.tcgetattr(sys.stdin)
        tty.setcbreak(sys.stdin)  # Ctrl-C stays a signal
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        import termios

        self._over.set()
        self._thread.join()
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, self._before)

    def _read(self) -> None:
        while not self._over.is_set():
            if select.select([0], [], [], LOOK)[0]:
                pressed = os.read(0, 64)
                if not pressed:  # the terminal has gone
                    return
                self.press(pressed)

    def press(self, pressed: bytes) -> None:
        """Do what keys say."""
        controls = self._controls
        if pressed == b" ":
            controls.start() if controls.paused else controls.pause()
        elif pressed in (RIGHT, LEFT):
            self._seek(self._ticks if pressed == RIGHT else -self._ticks)
            if controls.paused:
                controls.step()
        elif pressed == b"s":
            controls.step()
        elif pressed == b"r":
            controls.reset()
        elif pressed == b"q":
            controls.stop()
