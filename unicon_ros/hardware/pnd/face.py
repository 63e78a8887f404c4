"""Face of an Adam: LowState, with its battery or without, and LowCmd.

Not emulated, as it is not public: what the robot does when LowCmd stops, and yaw, pitch and roll,
which stay zero.
"""

from __future__ import annotations

import math

import numpy as np

from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_ros.hardware.dds.end import DdsFace
from unicon_ros.hardware.dds.maps import arrays_of
from unicon_ros.hardware.modes import EmulatedModes
from unicon_ros.hardware.pnd.platform import EXTRA, REMOTE, PndFacts


class PndFace(DdsFace):
    """What a driver sees of an emulated Adam.

    Args:
        states: of the emulator.
        robot: its file.
        address: of this machine's network interface, or its name.
        domain: of DDS, instead of the robot file's.
        battery: LowState is the one with the battery.

    Attributes:
        rate: of LowState in [Hz].
        dead_man: infinity: what the robot does is not public.
        obeys: always: no program of its own that must let go is known.
        remote: the 19 numbers of its remote, to be pressed.
        modes: of the motors, those of the last command; 0 before.

    Raises:
        UniconError: the robot file lacks a fact, or the network cannot be used.
    """

    label, extra, platform = "emulated pnd", EXTRA, "pnd"
    dead_man, obeys = math.inf, True

    def __init__(
        self,
        states: States,
        robot: Robot,
        *,
        address: str | None = "127.0.0.1",
        domain: int | None = None,
        battery: bool = True,
    ) -> None:
        facts, n = PndFacts.of(robot), robot.num_joints
        self.rate, self._facts = facts.rate, facts
        self.remote = np.zeros(REMOTE, np.float32)
        self._tick = np.zeros((), np.uint32)
        self.modes = EmulatedModes(np.zeros(n, np.uint8))
        own = {"remote": self.remote, "tick": self._tick, "modes": self.modes.reported}
        arrays = {"motor_error": np.zeros(n, np.uint32)} | arrays_of(states) | own
        modes = np.zeros(n, np.uint8)
        self._hears(states, robot, modes=modes, mode_pr=np.zeros((), np.uint8))
        super().__init__(facts.command_topic, facts.domain, domain, address)
        with self.closing():
            self.speak(facts.told(battery=battery), arrays)
            self.listen(facts.command, self._heard, anyone=True)

    def tell(self) -> None:
        """Send what the robot measures."""
        self._tick += 1
        self.put()

    def _acts(self) -> bool:
        facts, heard = self._facts, self._heard
        return self._right("mode_pr", heard["mode_pr"], facts.mode_pr) and self._right(
            "motor mode", heard["modes"], facts.mode
        )


face = PndFace
