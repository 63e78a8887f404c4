"""Face of an RH56 behind DDS: its state, and commands by position.

Of a DFX both hands are told, the other one where `others` says. Not emulated: forces, currents,
status, touch sensors, and what the hand does when commands stop.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_ros.hardware.dds.end import DdsEnd
from unicon_ros.hardware.dds.participant import Participant
from unicon_ros.hardware.inspire.dds.codec import ANGLES, HandFacts
from unicon_ros.hardware.inspire.dds.wire import EXTRA
from unicon_ros.hardware.wire import Counts

LABEL = "emulated inspire"
AS_IT_IS = -1
"""In an angle of the FTP: leave the finger as it is."""
TEMPERATURE = 35.0
"""What it tells where its simulator knows none, in [°C]."""


def face(
    states: States,
    robot: Robot,
    *,
    address: str | None = "127.0.0.1",
    domain: int | None = None,
) -> InspireDdsFace:
    """Build the hand's end.

    Args:
        address: of this machine's network interface, or its name.
        domain: of DDS, instead of the robot file's.

    Raises:
        UniconError: the robot file lacks a fact, or the network cannot be used.
    """
    return InspireDdsFace(states, robot, domain, address)


class InspireDdsFace(DdsEnd):
    """What a driver sees of an emulated hand.

    Attributes:
        rate: of its state in [Hz].
        dead_man: infinity: the hand holds its last target.
        obeys: always.
        told: all that it tells, those of a DFX's other hand among them.
        asked: all that it was told last.
    """

    platform = "inspire"
    dead_man = math.inf
    obeys = True

    def __init__(
        self, states: States, robot: Robot, domain: int | None, address: str | None
    ) -> None:
        facts, counts = HandFacts.of(robot), Counts()
        kind = facts.kind
        domain = facts.domain if domain is None else domain
        self.rate, self._facts, self._states = facts.rate, facts, states
        self.told: NDArray[Any] = np.full(kind.count, facts.open, kind.dtype)
        self.asked: NDArray[Any] = np.zeros(kind.count, kind.dtype)
        self._mode = np.full((), ANGLES, np.int8)
        defaults: dict[str, NDArray[Any]] = {
            "motor_error": np.zeros(robot.num_joints, np.int32),
            "motor_temperature": np.full(robot.num_joints, TEMPERATURE, np.float32),
        }
        arrays = defaults | {name: states[name] for name in states} | {"told": self.told}
        heard = {"targets": self.asked, "mode": self._mode}
        frames = facts.command_in(heard, counts)
        super().__init__(Participant(domain, address, LABEL, EXTRA), facts.command_topic, counts)
        with self.closing():
            command, state = facts.messages()
            encode = facts.state_out(arrays).encode
            self.speak(facts.state_topic, state, encode, name=kind.names[1])
            self.listen(facts.command_topic, command, frames, name=kind.names[0], anyone=True)

    def tell(self) -> None:
        """Send what the hand measures."""
        facts = self._facts
        self.told[facts.slots] = facts.to_wire(self._states["joint_pos"])[0]
        self.put()

    def hear(self) -> bool:
        """Bring the newest good command into the target positions; True where one came."""
        if not self.take():
            return False
        facts = self._facts
        if not int(self._mode) & ANGLES:
            self.counts.refuse("mode", f"{int(self._mode)}, which sets no angle")
            return False
        asked = self.asked[facts.slots]
        kept = asked == AS_IT_IS if facts.kind.dtype is np.int16 else np.zeros(len(asked), bool)
        targets = facts.to_angles(np.clip(asked, *facts.ends))
        np.copyto(self._states["joint_pos_target"], targets, where=~kept, casting="same_kind")
        return True
