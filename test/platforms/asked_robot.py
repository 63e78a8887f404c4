"""A robot in a child that is asked for everything that a gate asks for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from unicon_base.errors import Fault
from unicon_core.platforms.fake import FakeRobot
from unicon_core.platforms.kit.scene import Scene
from unicon_core.robots import Robot
from unicon_core.states import States


class AskedRobot(FakeRobot):
    """Counts what it has told, needs two steps before it obeys, or refuses in the second."""

    def __init__(self, states: States, robot: Robot, period: float, refuses: bool) -> None:
        super().__init__(states, robot, period, Scene(), 0.0)
        self._refuses = refuses
        self._told = 0
        self._steps = 0

    def recv(self) -> bool | None:
        self._told += 1
        return super().recv()

    def arrivals(self) -> int:
        return self._told

    def variant(self) -> Mapping[str, Any]:
        return {"mode_machine": 4}

    def commanders(self) -> Mapping[str, int]:
        return {"rt/lowcmd": 2}

    def prepare(self) -> str:
        self._steps += 1
        if self._steps == 2 and self._refuses:
            raise Fault("its own controller does not let go")
        return "" if self._steps > 2 else f"step {self._steps}"


def make(
    states: States, robot: Robot, period: float, *, refuses: bool = False, silent: bool = False
) -> AskedRobot:
    return AskedRobot(states, robot, period, refuses)
