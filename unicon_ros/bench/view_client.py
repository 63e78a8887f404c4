"""A client of a viewer, for `unicon bench view`: reads what is sent, or connects and stalls.

    python -m unicon_ros.bench.view_client SINK ADDRESS reads|stalled

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

__all__ = ["main"]


def main() -> int:
    """Run; 0 once the input has ended."""
    sink, address, kind = sys.argv[1:]
    os.nice(5)  # as a browser's would be, it is on another machine, or comes after whoever ticks
    split = urlsplit(address)
    origin = f"http://{split.netloc}"
    protocol = f"viser-v{version('viser')}" if sink == "page" else "foxglove.sdk.v1"
    raw = socket.create_connection((split.hostname, split.port))
    if kind == "stalled":
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    with connect(
        f"ws://{split.netloc}",
        sock=raw,
        origin=origin,  # type: ignore[arg-type]
        subprotocols=[Subprotocol(protocol)],
        max_size=None,
        compression=None,
    ) as client:
        print("connected", flush=True)
        count = 0
        while not select.select([0], [], [], 0.0 if kind == "reads" else 0.2)[0]:
            if kind == "reads":
                try:
                    client.recv(timeout=0.2)
                    count += 1
                except TimeoutError:
                    continue
        print(count, flush=True)
    return 0


if __name__ == "__main__":
    status = main()
    sys.stdout.flush()
    os._exit(status)
