"""Dex3Wire: HandState in, HandCmd out, over DDS."""

from __future__ import annotations

import time

import numpy as np

from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_ros.hardware.dds.end import DdsEnd
from unicon_ros.hardware.dds.maps import arrays_of
from unicon_ros.hardware.modes import UNDOCUMENTED, ModeGuard
from unicon_ros.hardware.unitree_dex3.codec import Dex3Facts, own_arrays

STOPS, STOP_PERIOD = 5, 0.01
"""How often and at which distance in [s] the stop is sent: at the 100 Hz of commands."""


class Dex3Wire(DdsEnd):
    """The connection to one hand.

    HandState has neither number nor checksum: a hand that repeats itself is not told from one that
    does not move.

    Args:
        states: what is measured goes into these, commands come from these.
        robot: its file.
        domain: of DDS; None for the robot file's.
        address: of this machine's network interface, or its name; None for the default.
        silent: nothing is sent.

    Attributes:
        modes: of the motors; no public source says whether a hand reports the commanded ones.

    Raises:
        UniconError: it cannot be opened.
    """

    label = "platform 'unitree_dex3'"

    def __init__(
        self,
        states: States,
        robot: Robot,
        domain: int | None,
        address: str | None,
        *,
        silent: bool = False,
    ) -> None:
        facts, own = Dex3Facts.of(robot), own_arrays(robot)
        arrays = arrays_of(states) | own
        self.modes = ModeGuard(self.label, robot.joint_names, facts.modes, settles=UNDOCUMENTED)
        self.modes.reported = own["modes"]
        self._pairs = own["temperatures"][0::2], own["temperatures"][1::2]
        self._hottest = arrays.get("motor_temperature")
        self._stop = facts.stop_out()
        self._commands_it = False
        super().__init__(facts.state_topic, facts.domain, domain, address)
        with self.closing():
            self.listen(facts.state, arrays)
            self.watch(facts.command_topic)
            if not silent:
                self.speak(facts.command, arrays)

    def take(self) -> int:
        """Bring the newest good frame into the states; return how many good ones have come."""
        number = super().take()
        if number and self._hottest is not None:
            np.maximum(*self._pairs, out=self._hottest)
        return number

    def put(self) -> None:
        """Send the command states.

        Raises:
            Fault: CycloneDDS refuses it.
        """
        super().put()
        self._commands_it = True

    def close(self) -> None:
        """Stop the motors that were commanded, and leave the domain."""
        try:
            if self._commands_it:
                self._commands_it = False
                for _ in range(STOPS):
                    self._outlets[0][0].write(self._stop())
                    time.sleep(STOP_PERIOD)
        finally:
            super().close()
