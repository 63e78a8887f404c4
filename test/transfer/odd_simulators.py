"""Simulators that end badly after a while, for the tests of transfers."""

from __future__ import annotations

import os
import signal
import sys
from typing import Any

from unicon_core.platforms.fake import FakePlatform
from unicon_core.platforms.kit.scene import Scene
from unicon_core.robots import Robot
from unicon_core.states import States

AFTER = 40
"""Ticks."""


class Odd(FakePlatform):
    """The fake, until a tick in which `happens` is called."""

    def __init__(self, states: States, robot: Robot, period: float, scene: Scene) -> None:
        super().__init__(states, robot, period, scene, 0.0)
        self._states, self._sent = states, 0

    def recv(self) -> bool | None:
        told = super().recv()
        if self._sent >= AFTER:
            self.happens()
        return told

    def send(self) -> bool | None:
        self._sent += 1
        return super().send()

    def happens(self) -> None:
        raise NotImplementedError


class Killed(Odd):
    def happens(self) -> None:
        print("the engine said this", file=sys.stderr, flush=True)
        os.kill(os.getpid(), signal.SIGKILL)


class Stopped(Odd):
    def happens(self) -> None:
        os.kill(os.getpid(), signal.SIGSTOP)


class NotANumber(Odd):
    def happens(self) -> None:
        self._states.joint_pos[2] = float("nan")


class Falls(Odd):
    def happens(self) -> None:
        self._states.projected_gravity = (0.0, -1.0, 0.0)


class Exits(Odd):
    def happens(self) -> None:
        os._exit(7)


class Floods(Odd):
    def happens(self) -> None:
        while True:
            os.write(1, b"warning: x\n" * 4096)


def _made(kind: type[Odd]) -> Any:
    def make(states: States, robot: Robot, period: float, scene: Scene) -> Odd:
        return kind(states, robot, period, scene)

    make.facts = FakePlatform.facts  # type: ignore[attr-defined]
    return make


killed, stopped, falls = _made(Killed), _made(Stopped), _made(Falls)
exits, floods, not_a_number = _made(Exits), _made(Floods), _made(NotANumber)
