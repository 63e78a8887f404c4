"""Takeover: brings a T1 from its own controller into custom mode, step by step, by its service.

The order is the vendor's: a person brings the robot into prepare mode, a first command is there,
and then the mode is changed (BoosterRobotics/booster_gym deploy/deploy.py and deploy/README.md,
BoosterRobotics/booster_deploy booster_deploy/controllers/booster_robot_controller.py).

Requests and responses of the service are JSON within two DDS topics. A response belongs to the
request whose uuid it carries (BoosterRobotics/booster_robotics_sdk include/booster/robot/rpc; the
ends of the topics' names were seen on the wire of its release 1.6.3).
"""

from __future__ import annotations

import json
import math
import time
import uuid
from collections.abc import Callable, Generator
from functools import partial
from typing import Any

from unicon_base import Fault, PlatformError
from unicon_core.platforms.kit.base import rpy_of_quat
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_hardware.booster.codec import BoosterFacts
from unicon_hardware.dds.end import DdsEndpoint
from unicon_hardware.dds.service import Procedure, ServiceEnd

SUCCESS = 0


def number(text: str, key: str) -> int | None:
    """Return a whole number of a JSON object, None where it has none."""
    try:
        found = json.loads(text)[key]
    except (ValueError, LookupError, TypeError, RecursionError):
        return None
    return found if type(found) is int else None


class _End(ServiceEnd):
    request = "booster_msgs/msg/RpcReqMsg", "{}Req"
    response = "booster_msgs/msg/RpcRespMsg", "{}Resp"


class Client(_End):
    """Asks the robot, one request at a time, without waiting; as `ServiceEnd`."""

    def ask(self, request: int, **parameters: int) -> None:
        """Send a request; what it is answered is told by `answer`."""
        self._asked = str(uuid.uuid4())
        header = json.dumps({"api_id": request, "expect_response": True})
        body = json.dumps(parameters) if parameters else ""
        self._say(self._types[self.request[0]](self._asked, header, body))

    def answer(self) -> tuple[int | None, str] | None:
        """Return status and body of the answer; None as long as there is none."""
        for said in self.heard():
            if said.uuid == self._asked:
                self._asked = None  # should it come again, it answers nothing else
                return number(said.header, "status"), said.body
        return None


class Server(_End):
    """Serves requests, for an emulated robot; as `ServiceEnd`."""

    serves = True

    def reply(self, asked: Any, status: int, **values: int) -> None:
        """Answer a request."""
        body, head = json.dumps(values) if values else "", json.dumps({"status": status})
        self._say(self._types[self.response[0]](asked.uuid, head, body))


AGAIN = 0.5
"""Between two requests in [s]."""
AHEAD = 0.1
"""How long commands are there before the mode is changed, in [s]; as the vendor's program."""
CODES = {
    100: "the robot's own controller was too slow; start the robot anew",
    400: "it does not know the mode; its firmware is another generation",
    409: "something else runs on it; end that with the app",
    429: "it is asked too often; end other programs that ask it",
    501: "bring the robot into prepare mode with the remote, and look at the app",
    502: "its state machine does not go there; bring it into prepare mode with the remote",
}
"""Status of a refusal, with remedy (booster_robotics_sdk include/booster/robot/rpc/error.hpp)."""


class Takeover(Procedure):
    """Brings it into custom mode, behind the operator's go.

    Args:
        client: of the robot's service.
        facts: of the robot file.
        found: somebody hears commands.
        hold: sends a command that holds the posture.
        what: in front of messages.
    """

    def __init__(
        self,
        client: Client,
        facts: BoosterFacts,
        found: Callable[[], bool],
        hold: Callable[[], None],
        what: str,
    ) -> None:
        super().__init__(what)
        self._client, self._found, self._hold = client, found, hold
        self._facts = facts

    def _procedure(self) -> Generator[str, None, None]:
        client = self._client
        yield from self._there(lambda: client.there, f"its service {client.service}")
        yield from self._there(self._found, "the receiver of its commands")
        while (mode := (yield from self._mode())) not in ("prepare", "custom"):
            yield from self._pause(
                f"a person to bring the robot into prepare mode with its remote or app, and to set "
                f"it on its feet (it is in mode {mode})",
                AGAIN,
            )
        doing = "its own controller to change into custom mode"
        for waiting in self._pause(doing, AHEAD):
            self._hold()
            yield waiting
        end = time.monotonic() + self.timeout
        while (yield from self._mode(hold=True)) != "custom":
            if time.monotonic() > end:
                raise Fault(
                    f"{self._what}: the robot is not in custom mode {self.timeout:g} s after it "
                    "was asked; bring it into prepare mode with the remote, and start anew"
                )
            yield from self._answer(
                "change_mode", doing, hold=True, mode=self._facts.modes["custom"]
            )

    def _there(self, found: Callable[[], bool], missing: str) -> Generator[str, None, bool]:
        lacking = f"{missing} is not there within {self.timeout:g} s; start the robot anew"
        return self._until(found, missing, lambda: lacking)

    def _mode(self, *, hold: bool = False) -> Generator[str, None, str]:
        """Return the mode's name."""
        body = yield from self._answer("get_mode", "which mode the robot is in", hold=hold)
        mode = number(body, "mode")
        if mode is None:
            raise Fault(
                f"{self._what}: GetMode answers {body[:60]!r}, which names no mode; the robot's "
                "firmware is another generation"
            )
        return self._facts.mode_name(mode)

    def _answer(
        self, request: str, doing: str, *, hold: bool, **parameters: int
    ) -> Generator[str, None, str]:
        """Ask, again where an answer is lost, and return its body."""
        client, asked = self._client, self._facts.requests[request]

        def answer() -> tuple[int | None, str] | None:
            if hold:
                self._hold()
            return client.answer()

        silent = (
            f"service {client.service} does not answer request {asked} within {self.timeout:g} s; "
            "start the robot anew"
        )
        ask = partial(client.ask, asked, **parameters)
        status, body = yield from self._until(answer, doing, lambda: silent, ask, 2.0 * AGAIN)
        if status != SUCCESS:
            why = CODES.get(status or 0, "see the robot's app")
            raise Fault(
                f"{self._what}: the robot refuses request {asked} with status {status}: {why}"
            )
        return body


SELDOM = 50
"""Mode and battery are told with every so many a frame."""
BAD_REQUEST, NOT_FROM_HERE = 400, 502


class BoosterEndpoint(DdsEndpoint):
    """An emulated T1: LowState, LowCmd, the service that changes its mode, battery and gamepad.

    Its state machine is stricter than what is public: custom mode from prepare mode alone, and only
    once a command is there. Not emulated, as it is not public: what the robot does when LowCmd
    stops, and its cranks, which are sent as its joints.

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

    label, extra, announced = "emulated booster", "hw-booster", True
    table, platform = BoosterFacts, "booster"
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
        self._commanded, self._told = False, 0
        self._build(states, robot, facts, address, domain)
        self.mode[...] = facts.modes[mode]

    def _open(self) -> None:
        super()._open()
        facts, joined = self._facts, self.participant
        self.mode = self.own["mode"]
        self._server = Server(joined, facts.rpc_topic)
        self._seldom = [
            (joined.writer(told.topic, told.struct), told.encoder(self._arrays).encode)
            for told in (facts.mode, facts.battery)
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
        self.own["rpy"][...] = rpy_of_quat(self._states["base_quat"])
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
