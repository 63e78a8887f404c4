"""Both ends of Booster's service: requests and responses, JSON within two DDS topics.

A response belongs to the request whose uuid it carries (BoosterRobotics/booster_robotics_sdk
include/booster/robot/rpc; the ends of the topics' names were seen on the wire of its release
1.6.3).
"""

from __future__ import annotations

import json
import uuid
from collections.abc import Iterator
from typing import Any

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
