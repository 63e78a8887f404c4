"""Servers of networks for tests: in a thread, in a process, and behind a slow link."""

from __future__ import annotations

import re
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

from slow_network import workflow
from zmq.auth import create_certificates

from unicon_base.resources import same_modules
from unicon_core.policies import load_policy
from unicon_core.policies.networks.remote_server import PolicyServer

ANY = "tcp://127.0.0.1:*"


@contextmanager
def serving(
    folder: Path | str, address: str = ANY, kind: Any = PolicyServer, keys: Path | None = None
) -> Iterator[PolicyServer]:
    """A server in a thread of this process."""
    with closing(kind(load_policy(folder), address, keys)) as server:
        thread = threading.Thread(target=server.run, daemon=True)
        thread.start()
        try:
            yield server
        finally:
            server.stop()
            thread.join()


@contextmanager
def served(folder: Path | str, *more: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """`unicon serve` in a process; yields it and its address."""
    command = [sys.executable, "-m", "unicon_ros", "serve", str(folder), "--bind", ANY, *more]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=same_modules())
    assert process.stdout is not None
    try:
        said = ""
        while "hash " not in said:
            line = process.stdout.readline()
            assert line, said
            said += line
        found = re.search(r"tcp://\S+", said)
        assert found is not None
        yield process, found[0]
    finally:
        process.kill()
        process.communicate()


def asking(folder: Path, address: str, **more: Any) -> dict[str, Any]:
    """Return a workflow whose policy is at a server; options of `remote`, others of the rest."""
    spec = {name: more.pop(name) for name in ("delay", "timeout", "keys") if name in more}
    values = workflow(folder, None, **more)
    values["policies"]["slow"]["remote"] = {"address": address, **spec}
    return values


def make_keys(folder: Path) -> Path:
    """Write the keys of a server and of a client that it knows."""
    (folder / "clients").mkdir(parents=True)
    for name in ("server", "client"):
        create_certificates(folder, name)
    (folder / "clients/robot.key").write_bytes((folder / "client.key").read_bytes())
    return folder


class SlowLink:
    """A TCP way to a port that takes `delay` [s] each way."""

    def __init__(self, address: str, delay: float) -> None:
        self._target, self._delay = int(address.rpartition(":")[2]), delay
        self._server = socket.create_server(("127.0.0.1", 0))
        self.address = f"tcp://127.0.0.1:{self._server.getsockname()[1]}"
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                near, _ = self._server.accept()
                far = socket.create_connection(("127.0.0.1", self._target))
                for way in ((near, far), (far, near)):
                    waiting: list[tuple[float, bytes]] = []
                    for carry in (self._take, self._give):
                        threading.Thread(target=carry, args=(*way, waiting), daemon=True).start()

    def _take(self, source: socket.socket, _: socket.socket, waiting: list[Any]) -> None:
        with suppress(OSError):
            while received := source.recv(1 << 16):
                waiting.append((time.monotonic() + self._delay, received))
        waiting.append((0.0, b""))

    def _give(self, _: socket.socket, sink: socket.socket, waiting: list[Any]) -> None:
        with suppress(OSError):
            while True:
                if not waiting or waiting[0][0] > time.monotonic():
                    time.sleep(0.0005)
                elif not (received := waiting.pop(0)[1]):
                    break
                else:
                    sink.sendall(received)
        sink.close()

    def close(self) -> None:
        self._server.close()
