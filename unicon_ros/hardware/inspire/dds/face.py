"""Face of an RH56 behind DDS: its state, and commands by position.

Of a DFX both hands are told, the other one where `others` says. Not emulated: forces, currents,
status, touch sensors, and what the hand does when commands stop.
"""

from __future__ import annotations

import math

import numpy as np

from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_ros.hardware.dds.end import DdsEnd
from unicon_ros.hardware.inspire.dds.wire import ANGLES, EXTRA, HandFacts
from unicon_ros.hardware.wire import Counts

AS_IT_IS = -1
"""In an angle of the FTP: leave the finger as it is."""
TEMPERATURE = 35.0
"""What it tells where its simulator knows none, in [°C]."""


class InspireDdsFace(DdsEnd):
    """What a driver sees of an emulated hand.

    Args:
        states: of the emulator.
        robot: its file.
        address: of this machine's network interface, or its name.
        domain: of DDS, instead of the robot file's.

    Attributes:
        rate: of its state in [Hz].
        dead_man: infinity: the hand holds its last target.
        obeys: always.
        told: all that it tells, those of a DFX's other hand among them.
        asked: all that it was told last.

    Raises:
        UniconError: the robot file lacks a fact, or the network cannot be used.
    """

    label, extra, platform = "emulated inspire", EXTRA, "inspire"
    dead_man, obeys = math.inf, True

    def __init__(
        self,
        states: States,
        robot: Robot,
        *,
        address: str | None = "127.0.0.1",
        domain: int | None = None,
    ) -> None:
        facts, counts, n = HandFacts.of(robot), Counts(), robot.num_joints
        self.rate, self._facts, self._states = facts.rate, facts, states
        self.told, self.asked = facts.zeros(), facts.zeros()
        self.told[...] = facts.open
        self._mode = np.full((), ANGLES, np.int8)
        heat = np.full(n, TEMPERATURE, np.float32)
        defaults = {"motor_error": np.zeros(n, np.int32), "motor_temperature": heat}
        arrays = defaults | {name: states[name] for name in states} | {"told": self.told}
        frames = facts.command_in({"targets": self.asked, "mode": self._mode}, counts)
        super().__init__(facts.command_topic, facts.domain, domain, address, counts=counts)
        with self.closing():
            self.speak(facts.state, arrays)
            self.listen(facts.command, frames, anyone=True)

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
        kept = (asked == AS_IT_IS) & (not facts.both)
        targets = facts.to_angles(np.clip(asked, *facts.ends))
        np.copyto(self._states["joint_pos_target"], targets, where=~kept, casting="same_kind")
        return True


face = InspireDdsFace
