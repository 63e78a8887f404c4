"""Face of a Dex3-1: HandState, and HandCmd with its mode bytes.

Not emulated, as it is not public: what the hand does when commands stop, its press sensors, which
tell 0, and its IMU.
"""

from __future__ import annotations

import math

import numpy as np

from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_ros.hardware.dds.end import DdsFace
from unicon_ros.hardware.dds.maps import arrays_of
from unicon_ros.hardware.modes import EmulatedModes
from unicon_ros.hardware.unitree_dex3.platform import TIMEOUT, Dex3Facts, own_arrays

TEMPERATURE = 35.0
"""What it tells where its simulator knows none, in [°C]."""


class Dex3Face(DdsFace):
    """What a driver sees of an emulated hand.

    Args:
        states: of the emulator.
        robot: its file.
        address: of this machine's network interface, or its name.
        domain: of DDS, instead of the robot file's.

    Attributes:
        rate: of HandState in [Hz].
        dead_man: infinity: what the hand does is not public.
        obeys: always.
        stopped: the last command was a stop.
        modes: of the motors, those of the last command; 0 before.

    Raises:
        UniconError: the robot file lacks a fact, or the network cannot be used.
    """

    label, platform = "emulated unitree_dex3", "unitree_dex3"
    dead_man, obeys = math.inf, True

    def __init__(
        self,
        states: States,
        robot: Robot,
        *,
        address: str | None = "127.0.0.1",
        domain: int | None = None,
    ) -> None:
        facts, own, n = Dex3Facts.of(robot), own_arrays(robot), robot.num_joints
        heat = np.full(n, TEMPERATURE, np.float32)
        defaults = {"motor_temperature": heat, "motor_error": np.zeros(n, np.uint32)}
        arrays = defaults | arrays_of(states) | own
        self.rate, self.stopped = facts.rate, False
        self._modes = np.array(facts.modes, np.uint8)
        self._pairs, self._heat = own["temperatures"].reshape(-1, 2), arrays["motor_temperature"]
        self._hears(states, robot, modes=np.zeros(n, np.uint8))
        self.modes = EmulatedModes(own["modes"])
        super().__init__(facts.command_topic, facts.domain, domain, address)
        with self.closing():
            self.speak(facts.state, arrays)
            self.listen(facts.command, self._heard, anyone=True)

    def tell(self) -> None:
        """Send what the hand measures."""
        self._pairs[...] = self._heat[:, None]
        self.put()

    def _acts(self) -> bool:
        modes = self._heard["modes"]
        stops = modes >= TIMEOUT
        if stops.any() != stops.all() or ((modes & ~np.uint8(TIMEOUT)) != self._modes).any():
            self.counts.refuse("motor mode", f"{modes.tolist()}")
            return False
        self.stopped = bool(stops.all())
        return True


face = Dex3Face
