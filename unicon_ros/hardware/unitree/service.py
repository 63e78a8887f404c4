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

from unicon_msgs_map.layout.messages import shared_messages
from unicon_ros.hardware.dds.objects import packed, unpacked
from unicon_ros.hardware.dds.participant import Participant

REQUEST, RESPONSE = "unitree_api/msg/Request", "unitree_api/msg/Response"


def _topic(service: str, way: str) -> str:
    return f"rt/api/{service}/{way}"


def _types() -> Any:
    messages = shared_messages()
    messages.struct(REQUEST)
    messages.struct(RESPONSE)
    return messages.store.types


def request(identity: int, number: int, parameter: str) -> Any:
    """Return a request that wants a response."""
    types = _types()
    part = "unitree_api/msg/Request{}".format
    header = types[part("Header")](
        types[part("Identity")](identity, number),
        types[part("Lease")](0),
        types[part("Policy")](0, False),
    )
    return types[REQUEST](header, parameter, np.zeros(0, np.uint8))


def response(asked: Any, code: int, data: str) -> Any:
    """Return the response to a request."""
    types = _types()
    status = types["unitree_api/msg/ResponseStatus"](code)
    header = types["unitree_api/msg/ResponseHeader"](asked.header.identity, status)
    return types[RESPONSE](header, data, np.zeros(0, np.uint8))


class Client:
    """Asks a robot's service, one request at a time, without waiting.

    Args:
        participant: of the robot's domain.
        service: its name.
    """

    def __init__(self, participant: Participant, service: str) -> None:
        messages = shared_messages()
        self.service = service
        self._writer = participant.writer(_topic(service, "request"), messages.struct(REQUEST))
        self._reader = participant.reader(_topic(service, "response"), messages.struct(RESPONSE))
        self._asked: Any = None

    @property
    def there(self) -> bool:
        """Whether somebody serves it."""
        return self._writer.matched and bool(self._reader.sources)

    def ask(self, number: int, parameter: str = "{}") -> None:
        """Send a request; what it is answered is told by `answer`."""
        self._asked = request(time.monotonic_ns(), number, parameter)
        self.repeat()

    def repeat(self) -> None:
        """Send the last request once more; the first answer to either counts."""
        self._writer.write(packed(self._asked))

    def answer(self) -> tuple[int, str] | None:
        """Return code and data of the answer, None as long as there is none."""
        for raw, info in self._reader.take():
            said = unpacked(raw, RESPONSE) if info.valid_data else None
            if said is not None and said.header.identity == self._asked.header.identity:
                return said.header.status.code, said.data
        return None


class Server:
    """Serves requests, for an emulated robot.

    Args:
        participant: of its domain.
        service: its name.
    """

    def __init__(self, participant: Participant, service: str) -> None:
        messages = shared_messages()
        self._writer = participant.writer(_topic(service, "response"), messages.struct(RESPONSE))
        self._reader = participant.reader(_topic(service, "request"), messages.struct(REQUEST))

    def asked(self) -> Iterator[Any]:
        """Give the requests that have come."""
        for raw, info in self._reader.take():
            said = unpacked(raw, REQUEST) if info.valid_data else None
            if said is not None:
                yield said

    def reply(self, asked: Any, code: int, data: str = "") -> None:
        """Answer a request."""
        self._writer.write(packed(response(asked, code, data)))
