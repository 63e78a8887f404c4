"""Face of a T1: LowState and LowCmd, the service that changes its mode, battery and gamepad.

What its own state machine takes is stricter than what is public: custom mode from prepare mode
alone, and only once a command is there. Not emulated, as it is not public: what the robot does when
LowCmd stops, and its cranks, which are told as its joints.
"""

from __future__ import annotations

import math

import numpy as np

from unicon_base.errors import PlatformError
from unicon_core.platforms.kit.base import rpy_of_quat
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_hardware.booster.codec import BoosterFacts
from unicon_hardware.booster.platform import EXTRA
from unicon_hardware.booster.takeover import SUCCESS, Server, number
from unicon_hardware.dds.face import DdsEndpoint

SELDOM = 50
"""Mode and battery are told with every so many a frame."""
BAD_REQUEST, NOT_FROM_HERE = 400, 502


class BoosterEndpoint(DdsEndpoint):
    """What a driver sees of an emulated T1.

    Args:
        states: of the emulator.
        robot: its file.
        address: of this machine's network interface, or its name.
        domain: of DDS, instead of the robot file's.
        mode: in which it begins: `damping`, `prepare`, `walking` or `custom`.

    Attributes:
        dead_man: infinity, as what the robot does is not public; 0 in its damping mode.
        obeys: it is in custom mode.
        mode: number of its mode.

    Raises:
        UniconError: the robot file lacks a fact, or the network cannot be used.
    """

    label, extra, platform = "emulated booster", EXTRA, "booster"
    _facts: BoosterFacts

    def __init__(
        self,
        states: States,
        robot: Robot,
        *,
        address: str = "127.0.0.1",
        domain: int | None = None,
        mode: str = "prepare",
    ) -> None:
        facts = BoosterFacts.of(robot)
        if mode not in facts.modes:
            raise PlatformError(
                f"{self.label}: mode is {mode!r}; give one of {', '.join(sorted(facts.modes))}"
            )
        self.mode = np.array(facts.modes[mode], np.int32)
        self._commanded, self._told = False, 0
        self._rpy = np.zeros(3, np.float32)
        own, heard = {"rpy": self._rpy, "mode": self.mode}, {"cmd_type": np.zeros((), np.uint32)}
        super().__init__(states, robot, facts, domain, address, own, heard, announced=True)
        with self.closing():
            self._server = Server(self.participant, facts.rpc_topic)
            self._seldom = [
                (
                    self.participant.writer(message.topic, message.struct),
                    message.encoder(self._arrays).encode,
                )
                for message in (facts.mode, facts.battery)
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
        came = super().hear()
        self._answer()
        return came

    def _acts(self) -> bool:
        right = self._right("cmd_type", self._heard["cmd_type"], self._facts.kind)
        self._commanded |= right
        return right and self.obeys

    def _answer(self) -> None:
        requests = self._facts.requests
        for asked in self._server.heard():
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


face = BoosterEndpoint
