"""Side: what a T1 tells besides LowState, each on a topic of its own: mode, battery, gamepad.

None of it counts as a sign of life.
"""

from __future__ import annotations

import numpy as np

from unicon_core.blocks.controls.device import Controls
from unicon_core.blocks.controls.remotes import REMOTES
from unicon_ros.hardware.booster.codec import BoosterFacts
from unicon_ros.hardware.dds.frames import HEADER
from unicon_ros.hardware.dds.inlet import Inlet
from unicon_ros.hardware.dds.maps import Arrays, Message
from unicon_ros.hardware.dds.participant import Participant
from unicon_ros.hardware.wire import Counts


class Side:
    """The other topics, of which a robot need not tell any.

    Args:
        participant: of the robot's domain.
        facts: of the robot file.
        arrays: states; the battery's are written where they are there.
        controls: take the gamepad; None where nobody asks for it.
    """

    def __init__(
        self,
        participant: Participant,
        facts: BoosterFacts,
        arrays: Arrays,
        controls: Controls | None,
    ) -> None:
        self._participant, self._counts = participant, Counts()
        self._number = np.full((), -1, np.int32)
        self._names = {value: name for name, value in facts.modes.items()}
        self._was_custom = False
        self._mode = self._inlet(facts.mode, {"mode": self._number})
        self._others: list[Inlet] = []
        if {"battery_charge", "battery_voltage"} <= set(arrays):
            self._others.append(self._inlet(facts.battery, arrays))
        if controls is not None:
            self._others.append(self._remote(facts.remote, controls))

    @property
    def mode(self) -> str:
        """Name of the mode that was told last, "-1" before."""
        return self._names.get(int(self._number), str(int(self._number)))

    def take(self) -> str:
        """Take what has come; return "custom", "another" mode behind it, or "" for not known."""
        for inlet in self._others:
            inlet.take()
        if self._mode.take():
            custom = self.mode == "custom"
            self._was_custom = self._was_custom or custom
        if not self._was_custom:  # older ones may still be on their way
            return ""
        return "custom" if self.mode == "custom" else "another"

    def _inlet(self, message: Message, arrays: Arrays) -> Inlet:
        frames = message.frames(arrays, self._counts)
        reader = self._participant.reader(message.topic, message.struct)
        return Inlet(reader, frames.good, frames.read, self._counts, message.topic)

    def _remote(self, message: Message, controls: Controls) -> Inlet:
        size, taken = REMOTES["booster"]

        def good(raw: bytes) -> bool:
            return raw[:2] == HEADER and 0 <= len(raw) - len(HEADER) - 2 - size < 4

        def read(raw: bytes) -> bool:
            taken(raw[4 : 4 + size], controls)
            return True

        reader = self._participant.reader(message.topic, message.struct)
        return Inlet(reader, good, read, self._counts, message.topic, controls.let_go)
