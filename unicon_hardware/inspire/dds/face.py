"""Face of an RH56 behind DDS: its state, and commands by position.

Of a DFX both hands are told, the other one where `others` says. Not emulated: forces, currents,
status, touch sensors, and what the hand does when commands stop.
"""

from __future__ import annotations

import numpy as np

from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_hardware.dds.face import DdsEndpoint
from unicon_hardware.inspire.dds.wire import ANGLES, EXTRA, HandFacts

AS_IT_IS = -1
"""In an angle of the FTP: leave the finger as it is."""


class InspireDdsEndpoint(DdsEndpoint):
    """What a driver sees of an emulated hand.

    Args:
        states: of the emulator.
        robot: its file.
        address: of this machine's network interface, or its name.
        domain: of DDS, instead of the robot file's.

    Attributes:
        told: all that it tells, those of a DFX's other hand among them.
        asked: all that it was told last.

    Raises:
        UniconError: the robot file lacks a fact, or the network cannot be used.
    """

    label, extra, platform = "emulated inspire", EXTRA, "inspire"

    def __init__(
        self,
        states: States,
        robot: Robot,
        *,
        address: str | None = "127.0.0.1",
        domain: int | None = None,
    ) -> None:
        facts = HandFacts.of(robot)
        self.told, self.asked = facts.zeros(), facts.zeros()
        self.told[...] = facts.open
        self._mode = np.full((), ANGLES, np.int8)
        own, heard = {"told": self.told}, {"targets": self.asked, "mode": self._mode}
        super().__init__(states, robot, facts, domain, address, own, heard)

    def tell(self) -> None:
        """Send what the hand measures."""
        facts = self._facts
        self.told[facts.slots] = facts.to_wire(self._states["joint_pos"])[0]
        self.put()

    def _acts(self) -> bool:
        acts = bool(int(self._mode) & ANGLES)
        if not acts:
            self.counts.refuse("mode", f"{int(self._mode)}, which sets no angle")
        return acts

    def _act(self) -> None:
        facts = self._facts
        asked = self.asked[facts.slots]
        kept = (asked == AS_IT_IS) & (not facts.both)
        targets = facts.to_angles(np.clip(asked, *facts.ends))
        np.copyto(self._states["joint_pos_target"], targets, where=~kept, casting="same_kind")


face = InspireDdsEndpoint
