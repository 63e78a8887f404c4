"""Both ends of Unitree's services: requests and responses on two DDS topics of each.

A response belongs to the request whose `id` and `api_id` it carries (unitreerobotics/
unitree_sdk2_python unitree_sdk2py/rpc/client_base.py, client_stub.py). None of this is for the
tick's hot path: messages go through rosbags' objects.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from unicon_ros.hardware.dds.participant import Participant
from unicon_ros.hardware.dds.service import ServiceEnd

REQUEST, RESPONSE = "unitree_api/msg/Request", "unitree_api/msg/Response"


class _End(ServiceEnd):
    def __init__(self, participant: Participant, service: str, writes: str, reads: str) -> None:
        ways = {REQUEST: "request", RESPONSE: "response"}
        topics = {kind: f"rt/api/{service}/{way}" for kind, way in ways.items()}
        super().__init__(participant, topics, writes, reads)
        self.service = service

    def _part(self, name: str, *values: Any) -> Any:
        return self._types[f"unitree_api/msg/{name}"](*values)


class Client(_End):
    """Asks a robot's service, one request at a time, without waiting.

    Args:
        participant: of the robot's domain.
        service: its name.
    """

    def __init__(self, participant: Participant, service: str) -> None:
        super().__init__(participant, service, REQUEST, RESPONSE)
        self._asked: Any = None

    def ask(self, number: int, parameter: str = "{}") -> None:
        """Send a request that wants a response, which is told by `answer`."""
        part = self._part
        identity = part("RequestIdentity", time.monotonic_ns(), number)
        policy = part("RequestPolicy", 0, False)
        header = part("RequestHeader", identity, part("RequestLease", 0), policy)
        self._asked = part("Request", header, parameter, np.zeros(0, np.uint8))
        self.repeat()

    def repeat(self) -> None:
        """Send the last request once more; the first answer to either counts."""
        self._say(self._asked)

    def answer(self) -> tuple[int, str] | None:
        """Return code and data of the answer, None as long as there is none."""
        for said in self._heard():
            if said.header.identity == self._asked.header.identity:
                return said.header.status.code, said.data
        return None


class Server(_End):
    """Serves requests, for an emulated robot.

    Args:
        participant: of its domain.
        service: its name.
    """

    def __init__(self, participant: Participant, service: str) -> None:
        super().__init__(participant, service, RESPONSE, REQUEST)

    def asked(self) -> Iterator[Any]:
        """Give the requests that have come."""
        return self._heard()

    def reply(self, asked: Any, code: int, data: str = "") -> None:
        """Answer a request."""
        status = self._part("ResponseStatus", code)
        header = self._part("ResponseHeader", asked.header.identity, status)
        self._say(self._part("Response", header, data, np.zeros(0, np.uint8)))
