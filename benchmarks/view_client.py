"""A client of a viewer, for `unicon bench view`: reads and answers what is sent, or stalls.

    python -m benchmarks.view_client SINK ADDRESS reads|stalled

It says `connected`, and how many messages it has read once its input ends.
"""

from __future__ import annotations

import os
import select
import socket
import sys
from importlib.metadata import version
from urllib.parse import urlsplit

from websockets.sync.client import connect
from websockets.typing import Subprotocol


def main() -> int:
    """Run; 0 once the input has ended."""
    sink, address, kind = sys.argv[1:]
    os.nice(19)  # a browser is on another machine, or comes after whoever ticks
    split = urlsplit(address)
    origin = f"http://{split.netloc}"
    protocol = f"viser-v{version('viser')}" if sink == "page" else "foxglove.sdk.v1"
    raw = socket.create_connection((split.hostname, split.port))
    if kind == "stalled":
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    with connect(
        f"ws://{split.netloc}",
        sock=raw,
        origin=origin,
        subprotocols=[Subprotocol(protocol)],
        max_size=None,
        compression=None,
    ) as client:
        if sink == "page":
            client.send(_camera())
        print("connected", flush=True)
        count = 0
        while not select.select([0], [], [], 0.0 if kind == "reads" else 0.2)[0]:
            if kind == "reads":
                try:
                    told = client.recv(timeout=0.2)
                except TimeoutError:
                    continue
                count += 1
                if sink == "page" and isinstance(told, bytes):
                    for answer in _answers(told):
                        client.send(answer)
        print(count, flush=True)
    return 0


def _camera() -> bytes:
    """Return where the client's eye is: viser counts a page from that message on."""
    import msgspec

    eye = {
        "type": "ViewerCameraMessage",
        "wxyz": (1.0, 0.0, 0.0, 0.0),
        "position": (2.0, -2.0, 1.0),
        "fov": 1.0,
        "near": 0.01,
        "far": 100.0,
        "image_height": 600,
        "image_width": 800,
        "look_at": (0.0, 0.0, 0.3),
        "up_direction": (0.0, 0.0, 1.0),
    }
    return msgspec.msgpack.encode(eye)


def _answers(told: bytes) -> list[bytes]:
    """Return what a page answers: it has handled what was sent so far (see `page/link.py`)."""
    import msgspec
    import zstandard

    size = int.from_bytes(told[8:16], "little")
    words = msgspec.msgpack.decode(zstandard.decompress(told[16 : 16 + size]))
    asked = (m for m in words["messages"] if m["type"] == "LocalStorageGetItemRequestMessage")
    answer = {"type": "LocalStorageGetItemResponseMessage", "value": "{}", "error": None}
    return [msgspec.msgpack.encode({**answer, "request_uuid": m["request_uuid"]}) for m in asked]


if __name__ == "__main__":
    status = main()
    sys.stdout.flush()
    os._exit(status)
