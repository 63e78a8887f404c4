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

from unicon_msgs_map.layout.messages import shared_messages
from unicon_ros.hardware.dds.objects import packed, unpacked
from unicon_ros.hardware.dds.participant import Participant

REQUEST, RESPONSE = "booster_msgs/msg/RpcReqMsg", "booster_msgs/msg/RpcRespMsg"
ENDS = {REQUEST: "Req", RESPONSE: "Resp"}
SUCCESS = 0


def number(text: str, key: str) -> int | None:
    """Return a whole number of a JSON object, None where it has none."""
    try:
        found = json.loads(text)[key]
    except (ValueError, LookupError, TypeError, RecursionError):
        return None
    return found if type(found) is int else None


def _made(name: str, *texts: str) -> bytes:
    return packed(shared_messages().store.types[name](*texts))


class _End:
    def __init__(self, participant: Participant, topic: str, writes: str, reads: str) -> None:
        messages = shared_messages()
        self._writer = participant.writer(topic + ENDS[writes], messages.struct(writes))
        self._reader = participant.reader(topic + ENDS[reads], messages.struct(reads))
        self._reads = reads

    def _heard(self) -> Iterator[Any]:
        for raw, info in self._reader.take():
            said = unpacked(raw, self._reads) if info.valid_data else None
            if said is not None:
                yield said


class Client(_End):
    """Asks the robot, one request at a time, without waiting.

    Args:
        participant: of the robot's domain.
        topic: of the service, without its end.
    """

    def __init__(self, participant: Participant, topic: str) -> None:
        super().__init__(participant, topic, REQUEST, RESPONSE)
        self.topic = topic
        self._asked = ""

    @property
    def there(self) -> bool:
        """Whether somebody serves it."""
        return self._writer.matched and bool(self._reader.sources)

    def ask(self, request: int, **parameters: int) -> None:
        """Send a request; what it is answered is told by `answer`."""
        self._asked = str(uuid.uuid4())
        header = json.dumps({"api_id": request, "expect_response": True})
        body = json.dumps(parameters) if parameters else ""
        self._writer.write(_made(REQUEST, self._asked, header, body))

    def answer(self) -> tuple[int | None, str] | None:
        """Return status and body of the answer; None as long as there is none."""
        for said in self._heard():
            if said.uuid == self._asked:
                return number(said.header, "status"), said.body
        return None


class Server(_End):
    """Serves requests, for an emulated robot.

    Args:
        participant: of its domain.
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
        self._writer.write(_made(RESPONSE, asked.uuid, json.dumps({"status": status}), body))
