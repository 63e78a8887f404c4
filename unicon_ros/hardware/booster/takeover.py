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
import time
import uuid
from collections.abc import Callable, Generator, Iterator
from typing import Any

from unicon_core.errors import Fault
from unicon_ros.hardware.booster.codec import BoosterFacts
from unicon_ros.hardware.dds.participant import Participant
from unicon_ros.hardware.dds.service import ServiceEnd

REQUEST, RESPONSE = "booster_msgs/msg/RpcReqMsg", "booster_msgs/msg/RpcRespMsg"
SUCCESS = 0


def number(text: str, key: str) -> int | None:
    """Return a whole number of a JSON object, None where it has none."""
    try:
        found = json.loads(text)[key]
    except (ValueError, LookupError, TypeError, RecursionError):
        return None
    return found if type(found) is int else None


class _End(ServiceEnd):
    def __init__(self, participant: Participant, topic: str, writes: str, reads: str) -> None:
        topics = {REQUEST: f"{topic}Req", RESPONSE: f"{topic}Resp"}
        super().__init__(participant, topics, writes, reads)
        self.topic = topic


class Client(_End):
    """Asks the robot, one request at a time, without waiting.

    Args:
        participant: of the robot's domain.
        topic: of the service, without its end.
    """

    def __init__(self, participant: Participant, topic: str) -> None:
        super().__init__(participant, topic, REQUEST, RESPONSE)
        self._asked = ""

    def ask(self, request: int, **parameters: int) -> None:
        """Send a request; what it is answered is told by `answer`."""
        self._asked = str(uuid.uuid4())
        header = json.dumps({"api_id": request, "expect_response": True})
        body = json.dumps(parameters) if parameters else ""
        self._say(self._types[REQUEST](self._asked, header, body))

    def answer(self) -> tuple[int | None, str] | None:
        """Return status and body of the answer; None as long as there is none."""
        for said in self._heard():
            if said.uuid == self._asked:
                return number(said.header, "status"), said.body
        return None


class Server(_End):
    """Serves requests, for an emulated robot.

    Args:
        participant: of the robot's domain.
        topic: of the service, without its end.
    """

    def __init__(self, participant: Participant, topic: str) -> None:
        super().__init__(participant, topic, RESPONSE, REQUEST)

    def asked(self) -> Iterator[Any]:
        """Give the requests that have come."""
        return self._heard()

    def reply(self, asked: Any, status: int, **values: int) -> None:
        """Answer a request."""
        body = json.dumps(values) if values else ""
        self._say(self._types[RESPONSE](asked.uuid, json.dumps({"status": status}), body))


TIMEOUT = 5.0
"""For the service to be found, an answer, and a mode to be reached, in [s]."""
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


class Takeover:
    """Called once a tick until it returns "", behind the operator's go.

    Args:
        client: of the robot's service.
        facts: of the robot file.
        found: somebody hears commands.
        hold: sends a command that holds the posture.
        what: in front of messages.

    Attributes:
        held: commands have been sent.
        done: the robot is in custom mode.
    """

    def __init__(
        self,
        client: Client,
        facts: BoosterFacts,
        found: Callable[[], bool],
        hold: Callable[[], None],
        what: str,
    ) -> None:
        self.held = self.done = False
        self._client, self._found, self._what = client, found, what
        self._hold_once = hold
        self._names = {value: name for name, value in facts.modes.items()}
        self._custom = facts.modes["custom"]
        self._requests = facts.requests
        self._steps = self._procedure()

    def __call__(self) -> str:
        """Go on without waiting; return what is waited for, "" at the end.

        Raises:
            Fault: the robot refuses, or does not answer.
        """
        if self.done:
            return ""
        missing = next(self._steps, "")
        self.done = not missing
        return missing

    def _procedure(self) -> Generator[str, None, None]:
        yield from self._there(lambda: self._client.there, f"its service {self._client.topic}")
        yield from self._there(self._found, "whoever hears its commands")
        while (mode := (yield from self._mode())) not in ("prepare", "custom"):
            yield from self._pause(
                f"a person to bring the robot into prepare mode with its remote or app, and to set "
                f"it on its feet (it is in mode {mode})"
            )
        doing = "its own controller to change into custom mode"
        end = time.monotonic() + AHEAD
        while time.monotonic() < end:
            self._hold()
            yield doing
        end = time.monotonic() + TIMEOUT
        while (yield from self._mode(hold=True)) != "custom":
            if time.monotonic() > end:
                raise Fault(
                    f"{self._what}: the robot is not in custom mode {TIMEOUT:g} s after it was "
                    "asked; bring it into prepare mode with the remote, and start anew"
                )
            yield from self._asked("change_mode", doing, hold=True, mode=self._custom)

    def _there(self, found: Callable[[], bool], missing: str) -> Generator[str, None, None]:
        end = time.monotonic() + TIMEOUT
        while not found():
            if time.monotonic() > end:
                raise Fault(
                    f"{self._what}: {missing} is not there within {TIMEOUT:g} s; start the robot "
                    "anew"
                )
            yield missing

    def _pause(self, doing: str) -> Generator[str, None, None]:
        end = time.monotonic() + AGAIN
        while time.monotonic() < end:
            yield doing

    def _hold(self) -> None:
        self.held = True
        self._hold_once()

    def _mode(self, *, hold: bool = False) -> Generator[str, None, str]:
        """Return the mode's name."""
        body = yield from self._asked("get_mode", "which mode the robot is in", hold=hold)
        mode = number(body, "mode")
        if mode is None:
            raise Fault(
                f"{self._what}: GetMode answers {body[:60]!r}, which names no mode; the robot's "
                "firmware is another generation"
            )
        return self._names.get(mode, str(mode))

    def _asked(
        self, request: str, doing: str, *, hold: bool, **parameters: int
    ) -> Generator[str, None, str]:
        """Ask, again where an answer is lost, and return its body."""
        end, due, asked = time.monotonic() + TIMEOUT, 0.0, self._requests[request]
        while (answer := self._client.answer() if due else None) is None:
            now = time.monotonic()
            if now > end:
                raise Fault(
                    f"{self._what}: service {self._client.topic} does not answer request {asked} "
                    f"within {TIMEOUT:g} s; start the robot anew"
                )
            if now >= due:
                self._client.ask(asked, **parameters)
                due = now + 2.0 * AGAIN
            if hold:
                self._hold()
            yield doing
        status, body = answer
        if status != SUCCESS:
            why = CODES.get(status or 0, "see the robot's app")
            raise Fault(
                f"{self._what}: the robot refuses request {asked} with status {status}: {why}"
            )
        return body
