"""A fake robot that writes down when commands leave, with delays and mistakes as options say."""

from __future__ import annotations

import time
from typing import Any

from unicon_core.platforms.fake import FakePlatform
from unicon_core.platforms.kit.scene import Scene
from unicon_core.robots import Robot
from unicon_core.states import States


class Recorded(FakePlatform):
    """Appends `send NS`, `damp NS` and `close NS` to a file; NS of the monotonic clock."""

    def __init__(
        self, states: States, robot: Robot, period: float, log: str, recv_s: float, fails: str
    ) -> None:
        super().__init__(states, robot, period, Scene(), 0.0)
        self._log = open(log, "a", buffering=1)  # noqa: SIM115
        self._recv_s, self._fails = recv_s, fails
        self._states, self._stiffest = states, 0.0
        self._sends = 0
        self._say("open")

    def _say(self, word: str) -> None:
        self._log.write(f"{word} {time.monotonic_ns()}\n")

    def recv(self) -> bool | None:
        """Take the time that a slow tick takes."""
        time.sleep(self._recv_s)
        if self._fails == "recv" and self._sends > 5:
            raise OSError("the cable is out")
        return super().recv()

    def send(self) -> bool | None:
        """Write down that a command left."""
        self._sends += 1
        stiffness = float(self._states.joint_stiffness.max())
        self._say("damp" if stiffness < self._stiffest else "send")
        self._stiffest = max(stiffness, self._stiffest)
        return super().send()

    def close(self) -> None:
        """Write down that it damps."""
        self._say("close")
        if self._fails == "close":
            raise OSError("the cable is out")


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    log: str,
    recv_s: float = 0.0,
    build_s: float = 0.0,
    fails: str = "",
) -> Recorded:
    """Build it.

    Args:
        log: file to write to.
        recv_s: what `recv` takes in [s].
        build_s: what building takes in [s].
        fails: `build`, `recv` or `close` raises OSError.
    """
    platform = Recorded(states, robot, period, log, recv_s, fails)
    time.sleep(build_s)
    if fails == "build":
        platform.close()
        raise OSError("no such port")
    return platform


def events(log: Any, word: str) -> list[int]:
    """Return the times of an event in [ns]."""
    lines = [line.split() for line in log.read_text().splitlines()] if log.exists() else []
    return [int(stamp) for said, stamp in lines if said == word]
