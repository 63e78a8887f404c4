"""Face of an Adam: LowState, with its battery or without, and LowCmd.

Not emulated, as it is not public: what the robot does when LowCmd stops, and yaw, pitch and roll,
which stay zero.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import COMMAND_STATES
from unicon_ros.hardware.dds.end import DdsEnd
from unicon_ros.hardware.dds.maps import arrays_of
from unicon_ros.hardware.dds.participant import Participant
from unicon_ros.hardware.modes import EmulatedModes
from unicon_ros.hardware.pnd.codec import COMMAND, REMOTE, STATE_NAME, STATES, PndFacts
from unicon_ros.hardware.pnd.wire import EXTRA
from unicon_ros.hardware.wire import Counts

LABEL = "emulated pnd"


def face(
    states: States,
    robot: Robot,
    *,
    address: str | None = "127.0.0.1",
    domain: int | None = None,
    battery: bool = True,
) -> PndFace:
    """Build the robot's end.

    Args:
        address: of this machine's network interface, or its name.
        domain: of DDS, instead of the robot file's.
        battery: LowState is the one with the battery.

    Raises:
        UniconError: the robot file lacks a fact, or the network cannot be used.
    """
    return PndFace(states, robot, domain, address, battery)


class PndFace(DdsEnd):
    """What a driver sees of an emulated Adam.

    Attributes:
        rate: of LowState in [Hz].
        dead_man: infinity: what the robot does is not public.
        obeys: always: no program of its own that must let go is known.
        remote: the 19 numbers of its remote, to be pressed.
        modes: of the motors, those of the last command; 0 before.
    """

    platform = "pnd"
    dead_man = math.inf
    obeys = True

    def __init__(
        self,
        states: States,
        robot: Robot,
        domain: int | None,
        address: str | None,
        battery: bool,
    ) -> None:
        facts, counts, n = PndFacts.of(robot), Counts(), robot.num_joints
        domain = facts.domain if domain is None else domain
        self.rate = facts.rate
        self.remote = np.zeros(REMOTE, np.float32)
        self._tick = np.zeros((), np.uint32)
        defaults: dict[str, NDArray[Any]] = {"motor_error": np.zeros(n, np.uint32)}
        self.modes = EmulatedModes(np.zeros(n, np.uint8))
        own = {"remote": self.remote, "tick": self._tick}
        arrays = defaults | arrays_of(states) | own | {"modes": self.modes.reported}
        self._states, self._facts = states, facts
        self._heard: dict[str, NDArray[Any]] = {
            name: np.zeros(n, np.float32) for name in COMMAND_STATES
        }
        self._heard |= {"modes": np.zeros(n, np.uint8), "mode_pr": np.zeros((), np.uint8)}
        frames = facts.command_in(self._heard, counts)
        super().__init__(Participant(domain, address, LABEL, EXTRA), facts.command_topic, counts)
        with self.closing():
            encode = facts.state_out(arrays, battery=battery).encode
            self.speak(facts.state_topic, facts.message(STATES[battery]), encode, name=STATE_NAME)
            self.listen(facts.command_topic, facts.message(COMMAND), frames, anyone=True)

    def tell(self) -> None:
        """Send what the robot measures."""
        self._tick += 1
        self.put()

    def hear(self) -> bool:
        """Bring the newest good command into the command states; True where one came."""
        if not self.take():
            return False
        heard = self._heard
        if heard["mode_pr"] != self._facts.mode_pr:
            self.counts.refuse("mode_pr", f"{heard['mode_pr']}, not {self._facts.mode_pr}")
            return False
        if (heard["modes"] != self._facts.mode).any():
            self.counts.refuse("motor mode", f"{heard['modes'].tolist()}")
            return False
        for name in COMMAND_STATES:
            self._states[name][...] = heard[name]
        self.modes.command(heard["modes"], self._states)
        return True
