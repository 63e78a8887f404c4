"""Face of a T1: LowState and LowCmd, the service that changes its mode, battery and gamepad.

What its own state machine takes is stricter than what is public: custom mode from prepare mode
alone, and only once a command is there. Not emulated, as it is not public: what the robot does when
LowCmd stops, and its cranks, which are told as its joints.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import PlatformError
from unicon_core.platforms.kit.base import rpy_of_quat
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import COMMAND_STATES
from unicon_msgs_map import Encoder
from unicon_ros.hardware.booster.codec import (
    BATTERY,
    COMMAND,
    MODE,
    PERCENT,
    STATE,
    BoosterFacts,
    command_arrays,
)
from unicon_ros.hardware.booster.service import SUCCESS, Server, number
from unicon_ros.hardware.booster.wire import EXTRA
from unicon_ros.hardware.dds.end import DdsEnd
from unicon_ros.hardware.dds.maps import arrays_of, publish
from unicon_ros.hardware.dds.participant import Participant
from unicon_ros.hardware.wire import Counts

LABEL = "emulated booster"
TEMPERATURE, VOLTAGE = 35.0, 48.0
"""What it tells where its simulator knows none, in [°C] and [V]."""
SELDOM = 50
"""Mode and battery are told with every so many a frame."""
BAD_REQUEST, NOT_FROM_HERE = 400, 502


def face(
    states: States,
    robot: Robot,
    *,
    address: str = "127.0.0.1",
    domain: int | None = None,
    mode: str = "prepare",
) -> BoosterFace:
    """Build the robot's end.

    Args:
        address: of this machine's network interface, or its name.
        domain: of DDS, instead of the robot file's.
        mode: in which it begins: `damping`, `prepare`, `walking` or `custom`.

    Raises:
        UniconError: the robot file lacks a fact, or the network cannot be used.
    """
    return BoosterFace(states, robot, domain, address, mode)


class BoosterFace(DdsEnd):
    """What a driver sees of an emulated T1.

    Attributes:
        rate: of LowState in [Hz].
        dead_man: infinity, as what the robot does is not public; 0 in its damping mode.
        obeys: it is in custom mode.
        mode: number of its mode.
    """

    platform = "booster"

    def __init__(
        self, states: States, robot: Robot, domain: int | None, address: str, mode: str
    ) -> None:
        facts, counts, n = BoosterFacts.of(robot), Counts(), robot.num_joints
        if mode not in facts.modes:
            raise PlatformError(
                f"{LABEL}: mode is {mode!r}; give one of {', '.join(sorted(facts.modes))}"
            )
        domain = facts.domain if domain is None else domain
        self.rate = facts.rate
        self.mode = np.array(facts.modes[mode], np.int32)
        self._states, self._facts = states, facts
        self._commanded, self._told = False, 0
        self._rpy = np.zeros(3, np.float32)
        defaults: dict[str, NDArray[Any]] = {
            "motor_temperature": np.full(n, TEMPERATURE, np.float32),
            "motor_error": np.zeros(n, np.uint32),
            "battery_charge": np.ones((), np.float32),
            "battery_voltage": np.array(VOLTAGE, np.float32),
        }
        arrays = defaults | arrays_of(states) | {"rpy": self._rpy}
        kind: NDArray[Any] = np.zeros((), np.uint32)
        self._heard = command_arrays(n) | {"cmd_type": kind}
        topics = facts.topics
        participant = Participant(domain, address, LABEL, EXTRA, announced=True)
        super().__init__(participant, f"{topics['command']} of DDS domain {domain}", counts)
        with self.closing():
            self.speak(topics["state"], facts.message(STATE), facts.state_out(arrays))
            frames = facts.command_in(self._heard, counts)
            self.listen(topics["command"], facts.message(COMMAND), frames, anyone=True)
            self._server = Server(participant, topics["rpc"])
            told = publish(topics["mode"], MODE, {"current_mode": "mode"})
            battery = facts.battery(publish, PERCENT)
            self._seldom = [
                (participant.writer(topics[name], facts.message(message)), encoder.encode)
                for name, message, encoder in (
                    ("mode", MODE, Encoder.build(told, {"mode": self.mode})),
                    ("battery", BATTERY, Encoder.build(battery, arrays)),
                )
            ]

    @property
    def obeys(self) -> bool:
        """Whether commands act."""
        return int(self.mode) == self._facts.modes["custom"]

    @property
    def dead_man(self) -> float:
        """How long it does what it was told last, in [s]."""
        return 0.0 if int(self.mode) == self._facts.modes["damping"] else math.inf

    def tell(self) -> None:
        """Send what the robot measures."""
        self._rpy[...] = rpy_of_quat(self._states["base_quat"])
        self.put()
        if self._told % SELDOM == 0:
            for writer, encode in self._seldom:
                writer.write(encode())
        self._told += 1

    def hear(self) -> bool:
        """Bring the newest good command into the command states, and answer requests."""
        came = bool(self.take()) and self._acted()
        self._answer()
        return came

    def _acted(self) -> bool:
        heard = self._heard
        if heard["cmd_type"] != self._facts.kind:
            self.counts.refuse("cmd_type", f"{heard['cmd_type']}, not {self._facts.kind}")
            return False
        self._commanded = True
        if not self.obeys:
            return False
        for name in COMMAND_STATES:
            self._states[name][...] = heard[name]
        return True

    def _answer(self) -> None:
        requests = self._facts.requests
        for asked in self._server.asked():
            request = number(asked.header, "api_id")
            if request == requests["get_mode"]:
                self._server.reply(asked, SUCCESS, mode=int(self.mode))
            elif request == requests["change_mode"]:
                self._server.reply(asked, self._changed(number(asked.body, "mode")))
            else:
                self._server.reply(asked, BAD_REQUEST)

    def _changed(self, wanted: int | None) -> int:
        """Change the mode; return the status."""
        modes = self._facts.modes
        if wanted is None or wanted not in modes.values():
            return BAD_REQUEST
        ready = self.obeys or (self._commanded and int(self.mode) == modes["prepare"])
        if wanted == modes["custom"] and not ready:
            return NOT_FROM_HERE
        self.mode[...] = wanted
        self._commanded = False
        self._told = 0  # it tells so at once
        return SUCCESS
