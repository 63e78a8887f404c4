"""Face of a Dex3-1: HandState, and HandCmd with its mode bytes.

Not emulated, as it is not public: what the hand does when commands stop, its press sensors, which
tell 0, and its IMU.
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
from unicon_ros.hardware.unitree_dex3.codec import (
    COMMAND,
    STATE,
    TIMEOUT,
    Dex3Facts,
    own_arrays,
)
from unicon_ros.hardware.wire import Counts

LABEL = "emulated unitree_dex3"
TEMPERATURE = 35.0
"""What it tells where its simulator knows none, in [°C]."""


def face(
    states: States,
    robot: Robot,
    *,
    address: str | None = "127.0.0.1",
    domain: int | None = None,
) -> Dex3Face:
    """Build the hand's end.

    Args:
        address: of this machine's network interface, or its name.
        domain: of DDS, instead of the robot file's.

    Raises:
        UniconError: the robot file lacks a fact, or the network cannot be used.
    """
    return Dex3Face(states, robot, domain, address)


class Dex3Face(DdsEnd):
    """What a driver sees of an emulated hand.

    Attributes:
        rate: of HandState in [Hz].
        dead_man: infinity: what the hand does is not public.
        obeys: always.
        stopped: the last command was a stop.
        modes: of the motors, those of the last command; 0 before.
    """

    platform = "unitree_dex3"
    dead_man = math.inf
    obeys = True

    def __init__(
        self, states: States, robot: Robot, domain: int | None, address: str | None
    ) -> None:
        facts, counts, own = Dex3Facts.of(robot), Counts(), own_arrays(robot)
        domain = facts.domain if domain is None else domain
        n = robot.num_joints
        defaults: dict[str, NDArray[Any]] = {
            "motor_temperature": np.full(n, TEMPERATURE, np.float32),
            "motor_error": np.zeros(n, np.uint32),
        }
        arrays = defaults | arrays_of(states) | own
        self.rate, self.stopped = facts.rate, False
        self._states, self._modes = states, np.array(facts.modes, np.uint8)
        self._pairs, self._heat = own["temperatures"].reshape(-1, 2), arrays["motor_temperature"]
        self._heard: dict[str, NDArray[Any]] = {
            name: np.zeros(n, np.float32) for name in COMMAND_STATES
        }
        self._heard["modes"] = np.zeros(n, np.uint8)
        self.modes = EmulatedModes(own["modes"])
        frames = facts.command_in(self._heard, counts)
        super().__init__(Participant(domain, address, LABEL), facts.command_topic, counts)
        with self.closing():
            self.speak(facts.state_topic, facts.message(STATE), facts.state_out(arrays))
            self.listen(facts.command_topic, facts.message(COMMAND), frames, anyone=True)

    def tell(self) -> None:
        """Send what the hand measures."""
        self._pairs[...] = self._heat[:, None]
        self.put()

    def hear(self) -> bool:
        """Bring the newest good command into the command states; True where one came."""
        if not self.take():
            return False
        heard = self._heard
        stops = bool((heard["modes"] & TIMEOUT).all())
        if not np.array_equal(heard["modes"] & ~np.uint8(TIMEOUT), self._modes) or (
            not stops and (heard["modes"] & TIMEOUT).any()
        ):
            self.counts.refuse("motor mode", f"{heard['modes'].tolist()}")
            return False
        self.stopped = stops
        for name in COMMAND_STATES:
            self._states[name][...] = heard[name]
        self.modes.command(heard["modes"], self._states)
        return True
