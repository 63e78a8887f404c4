"""Release: asks the robot's own controller to let go of the motors, step by step, by its services.

What is asked is what the vendor's examples ask before their first LowCmd: CheckMode, as long as it
names a mode: the sport service's StandDown (Go2), ReleaseMode, a pause, and again
(unitreerobotics/unitree_sdk2_python example/go2/low_level/go2_stand_example.py, unitree_sdk2
example/g1/low_level/g1_ankle_swing_example.cpp).

A service has two topics, of requests and of responses. A response belongs to the request whose `id`
and `api_id` it carries (unitreerobotics/unitree_sdk2_python unitree_sdk2py/rpc/client_base.py,
client_stub.py). None of this is for the tick's hot path: messages go through rosbags' objects.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Generator
from typing import Any

import numpy as np

from unicon_base.errors import Fault
from unicon_hardware.dds.participant import Participant
from unicon_hardware.dds.service import Procedure, ServiceEnd


class _End(ServiceEnd):
    request = "unitree_api/msg/Request", "rt/api/{}/request"
    response = "unitree_api/msg/Response", "rt/api/{}/response"

    def _part(self, name: str, *values: Any) -> Any:
        return self._types[f"unitree_api/msg/{name}"](*values)


class Client(_End):
    """Asks a robot's service, one request at a time, without waiting; as `ServiceEnd`."""

    def prepare(self, number: int, parameter: str = "{}") -> None:
        """Make a request that wants a response, which is told by `answer`."""
        part = self._part
        identity = part("RequestIdentity", time.monotonic_ns(), number)
        policy = part("RequestPolicy", 0, False)
        header = part("RequestHeader", identity, part("RequestLease", 0), policy)
        self._asked = part("Request", header, parameter, np.zeros(0, np.uint8))

    def ask(self) -> None:
        """Send the request, or send it once more; the first answer to either counts."""
        self._say(self._asked)

    def answer(self) -> tuple[int, str] | None:
        """Return code and data of the answer, None as long as there is none."""
        for said in self.heard():
            if said.header.identity == self._asked.header.identity:
                return said.header.status.code, said.data
        return None


class Server(_End):
    """Serves requests, for an emulated robot; as `ServiceEnd`."""

    serves = True

    def reply(self, asked: Any, code: int, data: str = "") -> None:
        """Answer a request."""
        status = self._part("ResponseStatus", code)
        header = self._part("ResponseHeader", asked.header.identity, status)
        self._say(self._part("Response", header, data, np.zeros(0, np.uint8)))


SWITCHER = "motion_switcher"
CHECK_MODE, RELEASE_MODE = 1001, 1003
AGAIN = 2.0
"""CheckMode, the first request of all, is repeated after so long, in [s]: a service that has found
the writer of requests, and not the reader of responses, answers nobody."""
TRIES = 5
"""Modes that are released in a row; who takes it again and again is told."""

CODES = {
    3203: "the service does not know the request; its firmware is another generation",
    3204: "the service does not take its parameter",
    3205: "another program holds the service's lease; end it",
    3206: "the lease is not there; end the programs that use the robot",
    3207: "another program holds the service's lease; end it",
}
"""What the vendor's services answer, with remedy (unitree_sdk2py/rpc/internal.py)."""


class Release(Procedure):
    """Lets the robot's own controller let go, behind the operator's go.

    Args:
        participant: of the robot's domain.
        before: service and number of a request before each ReleaseMode, or None.
        wait: pause behind it in [s].
        what: in front of messages.
    """

    def __init__(
        self, participant: Participant, before: tuple[str, int] | None, wait: float, what: str
    ) -> None:
        super().__init__(what)
        self._wait = wait
        self._switcher = Client(participant, SWITCHER)
        self._before = (Client(participant, before[0]), before[1]) if before else None

    def _procedure(self) -> Generator[str, None, None]:
        yield from self._found(self._switcher)
        for _ in range(TRIES):
            mode = yield from self._mode()
            if not mode:
                return
            doing = f"its controller, mode {mode!r}, to let go of the motors"
            if self._before is not None:
                client, number = self._before
                yield from self._found(client)
                yield from self._answer(client, number, f"{doing} ({client.service} {number})")
            yield from self._answer(self._switcher, RELEASE_MODE, f"{doing} (ReleaseMode)")
            yield from self._pause(doing, self._wait)
        mode = yield from self._mode()
        if mode:
            raise Fault(
                f"{self._what}: the robot's own controller has mode {mode!r} again after "
                f"ReleaseMode, {TRIES} times; switch it off with the remote or the app"
            )

    def _found(self, client: Client) -> Generator[str, None, bool]:
        return self._until(
            lambda: client.there,
            f"its service {client.service!r}",
            lambda: (
                f"nobody serves {client.service!r} within {self.timeout:g} s, so that its own "
                "controller cannot be asked to let go of the motors; start the robot anew, or for "
                "a simulator without it say peer: unitree_mujoco"
            ),
        )

    def _mode(self) -> Generator[str, None, str]:
        """Return the mode of its own controller, "" for none."""
        data = yield from self._answer(self._switcher, CHECK_MODE, "which controller runs")
        try:
            name = json.loads(data)["name"]
        except (ValueError, LookupError, TypeError):
            name = None
        if not isinstance(name, str):
            raise Fault(
                f"{self._what}: CheckMode of {SWITCHER!r} answers {data[:60]!r}, which names no "
                "mode; its firmware is another generation"
            )
        return name

    def _answer(self, client: Client, number: int, doing: str) -> Generator[str, None, str]:
        """Ask a service and return what it answers."""
        client.prepare(number)
        code, data = yield from self._until(
            client.answer,
            doing,
            lambda: (
                f"service {client.service!r} does not answer request {number} within "
                f"{self.timeout:g} s; start the robot anew"
            ),
            client.ask,
            AGAIN if number == CHECK_MODE else math.inf,  # it does nothing: not as others
        )
        if code:
            why = CODES.get(code, "switch the robot's own controller off with the remote or app")
            raise Fault(
                f"{self._what}: service {client.service!r} refuses request {number} with code "
                f"{code}: {why}"
            )
        return data
