"""Fake robots of which one thing goes wrong; they note what they are sent."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from unicon_base.errors import Fault, PlatformError
from unicon_core.platforms.fake import FakeRobot
from unicon_core.platforms.kit.scene import Scene
from unicon_core.robots import Robot
from unicon_core.states import States

LOG: list[tuple[str, str]] = []
"""Robot's name and what happened: `command`, `limp`, `closed`, `prepared`."""


class Noting(FakeRobot):
    """See the module.

    Args:
        after: ticks after which it goes wrong.
        wrong: `build`, `recv`, `send` or `close` raises.
    """

    facts = replace(FakeRobot.facts, name="noting")

    def __init__(
        self,
        states: States,
        robot: Robot,
        period: float,
        wrong: str,
        after: int,
        steps: int,
        others: int,
    ) -> None:
        if wrong == "build":
            raise PlatformError(f"build of {robot.name} failed")
        super().__init__(states, robot, period, Scene(), 0.0)
        self._states, self._robot = states, robot
        self._wrong, self._after, self._left = wrong, after, steps
        self.steps, self._others = steps, others

    def _note(self, what: str) -> None:
        LOG.append((self._robot.name, what))

    def _go_wrong(self, where: str) -> None:
        self._after -= where == "recv"
        if self._wrong == where and self._after <= 0:
            raise Fault(f"{where} of {self._robot.name} failed")

    def recv(self) -> bool | None:
        """Fail in time."""
        self._go_wrong("recv")
        return super().recv()

    def send(self) -> bool | None:
        """Note it."""
        limp = not self._states["joint_stiffness"].any()
        self._note("limp" if limp else "command")
        self._go_wrong("send")
        return super().send()

    def close(self) -> None:
        """Note it."""
        self._note("closed")
        self._go_wrong("close")

    def prepare(self) -> str:
        """Take some steps."""
        self._note("prepared")
        self._left -= 1
        return "" if self._left < 0 else f"{self._left + 1} steps left"

    def commanders(self) -> Mapping[str, int]:
        """So many others are there."""
        return {f"topic of {self._robot.name}": self._others}

    def variant(self) -> Mapping[str, Any]:
        """As the robot file says."""
        return {"protocol": self._robot.transport["protocol"]}


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    wrong: str = "",
    after: int = 0,
    steps: int = 0,
    others: int = 0,
    silent: bool = False,
) -> Noting:
    """Build one."""
    return Noting(states, robot, period, wrong, after, steps, others)
