"""Wheel: who drives; one viewer at a time, and none whose page is silent."""

from __future__ import annotations

import threading
from collections.abc import Sequence

import numpy as np

from unicon_lab.view.shown import DEAD_MAN
from unicon_lab.view.source import Remote


class Wheel:
    """Hands the robot to one viewer; its methods may be called in any thread.

    A velocity is sent only when the driver's page was heard, so that the run's own dead-man counts
    from there. A driver who is lost, by silence, a hidden page or a closed one, leaves the
    command at zero; he has to take the wheel anew, and whoever comes first may.

    Args:
        remote: what drives.
        bounds: lowest and highest vx, vy [m/s] and wz [rad/s].

    Attributes:
        driver: number of the viewer who drives; None for nobody.
        velocity: what he commands, shape (3,).
        lost: why the last driver was lost; "" when nobody was, or somebody drives again.
    """

    def __init__(self, remote: Remote, bounds: Sequence[tuple[float, float]]) -> None:
        self._remote, self._lock = remote, threading.RLock()
        self._low, self._high = np.array(bounds, float).reshape(-1, 2).T
        self._heard = 0.0
        self.driver: int | None = None
        self.velocity = np.zeros(3)
        self.lost = ""

    def take(self, viewer: int, now: float) -> str:
        """Let a viewer drive, from standstill.

        Args:
            viewer: its number.
            now: time in [s].

        Returns:
            "" or why not.
        """
        with self._lock:
            self.look(now)
            if not len(self._low):
                return "this workflow reads no velocity command: there is nothing to drive"
            if self.driver is not None and self.driver != viewer:
                return f"viewer {self.driver} drives; ask for the wheel to be let go"
            self.driver, self.lost, self._heard = viewer, "", now
            self.velocity[:] = 0.0
            self._remote.touch()
            return ""

    def let_go(self, viewer: int) -> None:
        """Give the command back to the workflow, where this viewer drives."""
        with self._lock:
            if self.driver == viewer:
                self.driver = None
                self._remote.let_go()

    def steer(self, viewer: int, velocity: Sequence[float], now: float) -> bool:
        """Command a velocity; False where this viewer does not drive.

        Args:
            viewer: its number.
            velocity: brought into the bounds; what is not finite is not taken.
            now: time in [s].
        """
        wanted = np.asarray(velocity, float)
        with self._lock:
            self.look(now)
            if self.driver != viewer or wanted.shape != (3,) or not np.isfinite(wanted).all():
                return False
            self.velocity[:] = np.clip(wanted, self._low, self._high)
            return self.heard(viewer, now)

    def heard(self, viewer: int, now: float) -> bool:
        """Note that a viewer's page answered; True where it drives on."""
        with self._lock:
            self.look(now)
            if self.driver != viewer:
                return False
            self._heard = now
            self._remote.drive(self.velocity)
            return True

    def look(self, now: float) -> None:
        """Take the wheel from a driver whose page was silent for `DEAD_MAN` seconds."""
        with self._lock:
            if self.driver is not None and now - self._heard > DEAD_MAN:
                self.lose(self.driver, "was silent")

    def lose(self, viewer: int, why: str) -> None:
        """Take the wheel from a driver at once: his page is closed, or hidden."""
        with self._lock:
            if self.driver == viewer:
                self.velocity[:] = 0.0
                self._remote.drive(self.velocity)
                self.driver = None
                self.lost = f"the page of viewer {viewer}, who drove, {why}: velocity zero"
