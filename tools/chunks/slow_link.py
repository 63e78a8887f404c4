"""A TCP link that takes its time, in front of a server on this machine."""

from __future__ import annotations

import os
import socket
import threading
import time
from contextlib import suppress
from typing import Any


class SlowLink:
    """A TCP way to a port that takes `delay` [s] each way.

    Attributes:
        address: where it listens.
        garbles: what the server says arrives as random bytes.
    """

    garbles = False

    def __init__(self, address: str, delay: float) -> None:
        self._target, self._delay = int(address.rpartition(":")[2]), delay
        self._server = socket.create_server(("127.0.0.1", 0))
        self.address = f"tcp://127.0.0.1:{self._server.getsockname()[1]}"
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                near, _ = self._server.accept()
                try:
                    far = socket.create_connection(("127.0.0.1", self._target))
                except OSError:  # the server has gone
                    near.close()
                    continue
                for way in ((near, far), (far, near)):
                    waiting: list[tuple[float, bytes]] = []
                    garbled = way[0] is far
                    threading.Thread(target=self._take, args=(way[0], waiting), daemon=True).start()
                    arguments = (way[1], waiting, garbled)
                    threading.Thread(target=self._give, args=arguments, daemon=True).start()

    def _take(self, source: socket.socket, waiting: list[Any]) -> None:
        with suppress(OSError):
            while received := source.recv(1 << 16):
                waiting.append((time.monotonic() + self._delay, received))
        waiting.append((0.0, b""))

    def _give(self, sink: socket.socket, waiting: list[Any], garbled: bool) -> None:
        with suppress(OSError):
            while True:
                if not waiting or waiting[0][0] > time.monotonic():
                    time.sleep(0.0005)
                elif not (received := waiting.pop(0)[1]):
                    break
                else:
                    garbles = garbled and self.garbles
                    sink.sendall(os.urandom(len(received)) if garbles else received)
        sink.close()

    def close(self) -> None:
        """Listen no more."""
        self._server.close()
