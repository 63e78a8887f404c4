"""A client of the Foxglove WebSocket protocol, for tests.

https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md, which foxglove-sdk serves as
`foxglove.sdk.v1`. Run as a program it reads every message and tells how many, or stalls.
"""

from __future__ import annotations

import json
import struct
import sys
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

from websockets.sync.client import connect
from websockets.typing import Origin, Subprotocol


class Client:
    """Connects; `channels`, `services` and `parameters` are as the server has told them."""

    def __init__(self, address: str, origin: str | None = None) -> None:
        self._socket = connect(
            address,
            origin=None if origin is None else Origin(origin),
            subprotocols=[Subprotocol("foxglove.sdk.v1")],
            max_size=None,
            compression=None,
        )
        self.channels: dict[str, dict[str, Any]] = {}
        self.services: dict[str, dict[str, Any]] = {}
        self.parameters: dict[str, Any] = {}
        self.messages: list[tuple[str, int, bytes]] = []
        self.statuses: list[str] = []
        self.answers: dict[int, bytes] = {}
        self.assets: dict[int, tuple[bool, bytes]] = {}
        self.info: dict[str, Any] = {}
        self._topics: dict[int, str] = {}
        self._calls = 0

    def until(self, holds: Callable[[], bool], patience: float = 5.0) -> None:
        """Read until something holds."""
        end = time.monotonic() + patience
        while not holds():
            assert time.monotonic() < end, (self.channels, self.statuses, len(self.messages))
            self.read(0.1)

    def read(self, timeout: float) -> None:
        """Take one message, if there is one."""
        try:
            told = self._socket.recv(timeout=timeout)
        except TimeoutError:
            return
        if isinstance(told, str):
            self._told(json.loads(told))
        elif told[0] == 1:
            number, stamp = struct.unpack_from("<IQ", told, 1)
            self.messages.append((self._topics[number], stamp, told[13:]))
        elif told[0] == 3:
            call, length = struct.unpack_from("<II", told, 5)
            self.answers[call] = told[13 + length :]
        elif told[0] == 4:
            call, refused, length = struct.unpack_from("<IBI", told, 1)
            self.assets[call] = not refused, told[10:] if not refused else told[10 : 10 + length]

    def _told(self, told: dict[str, Any]) -> None:
        if told["op"] == "serverInfo":
            self.info = told
        elif told["op"] == "advertise":
            self.channels |= {each["topic"]: each for each in told["channels"]}
        elif told["op"] == "advertiseServices":
            self.services |= {each["name"]: each for each in told["services"]}
        elif told["op"] == "parameterValues":
            self.parameters |= {each["name"]: each["value"] for each in told["parameters"]}
        elif told["op"] == "status":
            self.statuses.append(told["message"])

    def say(self, **words: Any) -> None:
        """Say something as JSON."""
        self._socket.send(json.dumps(words))

    def subscribe(self, *topics: str) -> None:
        """Subscribe to topics that are advertised."""
        wanted = []
        for topic in topics:
            self.until(lambda topic=topic: topic in self.channels)  # type: ignore[misc]
            number = len(self._topics) + 1
            self._topics[number] = topic
            wanted.append({"id": number, "channelId": self.channels[topic]["id"]})
        self.say(op="subscribe", subscriptions=wanted)

    def advertise(self, topic: str, schema: str, encoding: str = "cdr", number: int = 1) -> None:
        """Say that messages will come."""
        channel = {"id": number, "topic": topic, "encoding": encoding, "schemaName": schema}
        self.say(op="advertise", channels=[channel])

    def publish(self, data: bytes, number: int = 1) -> None:
        """Publish a message."""
        self._socket.send(struct.pack("<BI", 1, number) + data)

    def call(self, service: str) -> tuple[bool, str]:
        """Call a std_srvs/srv/Trigger."""
        self.until(lambda: service in self.services)
        self._calls += 1
        head = struct.pack("<BIII", 2, self.services[service]["id"], self._calls, 3)
        self._socket.send(head + b"cdr" + b"\x00\x01\x00\x00\x00")
        self.until(lambda: self._calls in self.answers)
        raw = self.answers[self._calls]
        return bool(raw[4]), raw[12:-1].decode()

    def fetch(self, uri: str) -> bytes | None:
        """Return the asset of a URI, None where it is refused."""
        self._calls += 1
        self.say(op="fetchAsset", uri=uri, requestId=self._calls)
        self.until(lambda: self._calls in self.assets)
        given, told = self.assets[self._calls]
        return told if given else None

    def close(self) -> None:
        """Leave."""
        self._socket.close()


def main() -> None:
    """`ADDRESS reads SECONDS` or `ADDRESS stalls SECONDS`; tells messages by topic as JSON."""
    address, kind, seconds = sys.argv[1], sys.argv[2], float(sys.argv[3])
    client = Client(address)
    client.until(lambda: "/clock" in client.channels)
    client.subscribe(*client.channels)
    print("connected", flush=True)
    end = time.monotonic() + seconds
    if kind == "stalls":
        time.sleep(seconds)
        return
    while time.monotonic() < end:
        client.read(0.1)
    stamps = [stamp for topic, stamp, _ in client.messages if topic == "/clock"]
    print(json.dumps([Counter(topic for topic, _, _ in client.messages), stamps]), flush=True)


if __name__ == "__main__":
    main()
