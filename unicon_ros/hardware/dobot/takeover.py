"""Takeover: asks an Atom's own state machine to let joint commands act, step by step.

Joint commands act in some states of it only, whose numbers are not public, and the arms must be
switched over besides (Dobot-Arm/dobot_atom_ros2 "DDS接口整理.md").
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import Fault
from unicon_ros.hardware.dds.maps import Message
from unicon_ros.hardware.dds.participant import Participant
from unicon_ros.hardware.dobot.codec import DobotFacts

TIMEOUT, AGAIN = 5.0, 0.2
"""For a state to be reached, and between two requests, in [s]."""


class Takeover:
    """Called once a tick until it returns "", behind the operator's go.

    Args:
        participant: of the robot's domain.
        facts: of the robot file.
        told: `fsm_id` and `upper_control`, as the robot told them last.
        wanted: number of the state in which joint commands act.
        what: in front of messages.

    Attributes:
        done: the robot is ours.
    """

    def __init__(
        self,
        participant: Participant,
        facts: DobotFacts,
        told: tuple[NDArray[Any], NDArray[Any]],
        wanted: int,
        what: str,
    ) -> None:
        self.done = False
        self._fsm, self._arms = told
        self._wanted, self._what = wanted, what
        self._ask_fsm = _asking(participant, facts.fsm, wanted)
        self._ask_arms = _asking(participant, facts.switch, 1)
        self._steps = self._procedure()

    def __call__(self) -> str:
        """Go on without waiting; return what is waited for, "" at the end.

        Raises:
            Fault: the robot does not do it in time.
        """
        if not self.done:
            missing = next(self._steps, "")
            self.done = not missing
            return missing
        return ""

    def check(self) -> None:
        """Look whether the robot is still ours, once it was.

        Raises:
            Fault: it is not.
        """
        if not self.done:
            return
        if int(self._fsm) != self._wanted:
            raise Fault(
                f"{self._what}: the robot's own state machine is in {int(self._fsm)}, and no "
                f"longer in {self._wanted}: the remote or another program has taken the robot"
            )
        if not self._arms:
            raise Fault(f"{self._what}: the arms were switched back to the robot's own controller")

    def _procedure(self) -> Generator[str, None, None]:
        doing = f"its own state machine to go to {self._wanted}"
        yield from self._until(lambda: int(self._fsm) == self._wanted, self._ask_fsm, doing)
        yield from self._until(lambda: bool(self._arms), self._ask_arms, "the arms to be ours")

    def _until(
        self, reached: Callable[[], bool], ask: Callable[[], None], doing: str
    ) -> Generator[str, None, None]:
        end, due = time.monotonic() + TIMEOUT, 0.0
        while not reached():
            now = time.monotonic()
            if now > end:
                raise Fault(
                    f"{self._what}: waited {TIMEOUT:g} s for {doing}; it is in "
                    f"{int(self._fsm)}: use the remote, and check the option fsm_id"
                )
            if now >= due:
                ask()
                due = now + AGAIN
            yield doing


def _asking(participant: Participant, message: Message, value: int) -> Callable[[], None]:
    writer = participant.writer(message.topic, message.struct)
    wanted = np.array(value, np.uint16)
    raw = message.encoder(dict.fromkeys(message.fields, wanted)).encode()
    raw += bytes(-len(raw) % 4)
    return lambda: writer.write(raw)
