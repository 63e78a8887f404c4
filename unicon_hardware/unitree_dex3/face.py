"""Face of a Dex3-1: HandState, and HandCmd with its mode bytes.

Not emulated, as it is not public: what the hand does when commands stop, its press sensors, which
tell 0, and its IMU.
"""

from __future__ import annotations

import numpy as np

from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_hardware.dds.face import DdsEndpoint
from unicon_hardware.unitree_dex3.platform import TIMEOUT, Dex3Facts, own_arrays


class Dex3Endpoint(DdsEndpoint):
    """What a driver sees of an emulated hand.

    Args:
        states: of the emulator.
        robot: its file.
        address: of this machine's network interface, or its name.
        domain: of DDS, instead of the robot file's.

    Attributes:
        stopped: the last command was a stop.

    Raises:
        UniconError: the robot file lacks a fact, or the network cannot be used.
    """

    label, platform = "emulated unitree_dex3", "unitree_dex3"

    def __init__(
        self,
        states: States,
        robot: Robot,
        *,
        address: str | None = "127.0.0.1",
        domain: int | None = None,
    ) -> None:
        facts, own = Dex3Facts.of(robot), own_arrays(robot)
        self.stopped = False
        self._modes, self._pairs = (
            np.array(facts.modes, np.uint8),
            own["temperatures"].reshape(-1, 2),
        )
        heard = {"modes": np.zeros_like(self._modes)}
        super().__init__(states, robot, facts, domain, address, own, heard)

    def tell(self) -> None:
        """Send what the hand measures."""
        self._pairs[...] = self._arrays["motor_temperature"][:, None]
        self.put()

    def _acts(self) -> bool:
        modes = self._heard["modes"]
        stops = modes >= TIMEOUT
        if stops.any() != stops.all() or ((modes & ~np.uint8(TIMEOUT)) != self._modes).any():
            self.counts.refuse("motor mode", f"{modes.tolist()}")
            return False
        self.stopped = bool(stops.all())
        return True


face = Dex3Endpoint
