"""Face of an Adam: LowState, with its battery or without, and LowCmd.

Not emulated, as it is not public: what the robot does when LowCmd stops, and yaw, pitch and roll,
which stay zero.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_hardware.dds.face import DdsEndpoint
from unicon_hardware.dds.maps import Arrays
from unicon_hardware.pnd.platform import EXTRA, REMOTE, PndFacts


class PndEndpoint(DdsEndpoint):
    """What a driver sees of an emulated Adam.

    Args:
        states: of the emulator.
        robot: its file.
        address: of this machine's network interface, or its name.
        domain: of DDS, instead of the robot file's.
        battery: LowState is the one with the battery.

    Attributes:
        remote: the 19 numbers of its remote, to be pressed.

    Raises:
        UniconError: the robot file lacks a fact, or the network cannot be used.
    """

    label, extra, platform = "emulated pnd", EXTRA, "pnd"

    def __init__(
        self,
        states: States,
        robot: Robot,
        *,
        address: str | None = "127.0.0.1",
        domain: int | None = None,
        battery: bool = True,
    ) -> None:
        facts = replace(PndFacts.of(robot), battery=battery)
        self.remote, self._tick = np.zeros(REMOTE, np.float32), np.zeros((), np.uint32)
        modes, heard = np.zeros((2, robot.num_joints), np.uint8)
        own: Arrays = {"remote": self.remote, "tick": self._tick, "modes": modes}
        more = {"modes": heard, "mode_pr": np.zeros((), np.uint8)}
        super().__init__(states, robot, facts, domain, address, own, more)

    def tell(self) -> None:
        """Send what the robot measures."""
        self._tick += 1
        self.put()

    def _acts(self) -> bool:
        facts, heard = self._facts, self._heard
        return self._right("mode_pr", heard["mode_pr"], facts.mode_pr) and self._right(
            "motor mode", heard["modes"], facts.mode
        )


face = PndEndpoint
