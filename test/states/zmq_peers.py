"""Peers for the tests of zmq: processes that write or read a group, and a TCP link that is cut."""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from unicon_core.states import StateSpec

SPECS = {
    "joint_pos": StateSpec((12,)),
    "velocity_command": StateSpec((3,)),
    "stamp_ns": StateSpec((), "int64"),
}
RATE = 500.0  # Hz

# Each value tells when it was made, on the clock that all processes of this machine share.
WRITER = """
import sys, time
from unicon_core.states import States, StateSpec
from unicon_core.states.backends.zmq import ZmqWriter

address, bind, mark, joints, name, keys = sys.argv[1:]
states = States({
    "joint_pos": StateSpec((int(joints),)),
    "velocity_command": StateSpec((3,)),
    "stamp_ns": StateSpec((), "int64"),
})
writer = ZmqWriter(address, name, states.layout, states, bind=bind == "bind", keys=keys or None)
states.joint_pos = float(mark)
print(writer.address, flush=True)
while True:
    states.stamp_ns = time.monotonic_ns()
    writer.publish()
    time.sleep(1 / RATE)
""".replace("RATE", str(RATE))

READER = """
import sys, time
from unicon_core.states import States, StateSpec
from unicon_core.states.backends.zmq import ZmqReader

states = States({"data": StateSpec((int(sys.argv[2]),))})
reader = ZmqReader(sys.argv[1], "bulk", states.layout, states)
while not reader.take():
    time.sleep(0.001)
print("reads", flush=True)
while True:
    reader.wait(0.1)
    reader.take()
"""


@contextmanager
def process(code: str, *arguments: object) -> Iterator[subprocess.Popen[str]]:
    """A process that is killed in the end."""
    command = [sys.executable, "-c", code, *map(str, arguments)]
    peer = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        yield peer
    finally:
        peer.kill()
        peer.wait()
        assert peer.stdout is not None
        peer.stdout.close()


def first_line(peer: subprocess.Popen[str]) -> str:
    assert peer.stdout is not None
    return peer.stdout.readline().strip()


@contextmanager
def writing(
    address: str,
    *,
    bind: bool = True,
    mark: float = 1.0,
    joints: int = 12,
    name: str = "measured",
    keys: Path | str = "",
) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A process that publishes `RATE` times a second; yields it and its address."""
    end = "bind" if bind else "connect"
    with process(WRITER, address, end, mark, joints, name, keys) as peer:
        yield peer, first_line(peer)


class Link:
    """A TCP way to another port that keeps all bytes while it is cut, and gives them later.

    Args:
        target: port of 127.0.0.1 to which it leads.
        port: where it listens; any free one if 0.
    """

    def __init__(self, target: int, port: int = 0) -> None:
        self._target = target
        self._open = threading.Event()
        self._open.set()
        self._ended = False
        self._server = socket.create_server(("127.0.0.1", port))
        self._sockets: list[socket.socket] = []
        self.address = f"tcp://127.0.0.1:{self._server.getsockname()[1]}"
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self) -> None:
        """Keep everything from now on."""
        self._open.clear()

    def mend(self) -> None:
        """Let go what was kept, in order, a little at a time."""
        self._open.set()

    def break_connections(self) -> None:
        """End every connection; new ones are let in again."""
        ended, self._sockets = self._sockets, []
        for each in ended:
            with suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            each.close()

    def close(self) -> None:
        self._ended = True
        self._open.set()
        self._server.close()
        self.break_connections()

    def _accept(self) -> None:
        while not self._ended:
            try:
                near, _ = self._server.accept()
            except OSError:
                return
            if not self._open.is_set():
                near.close()
                continue
            try:
                far = socket.create_connection(("127.0.0.1", self._target))
            except OSError:
                near.close()
                continue
            self._sockets += [near, far]
            for source, sink in ((near, far), (far, near)):
                threading.Thread(target=self._carry, args=(source, sink), daemon=True).start()

    def _carry(self, source: socket.socket, sink: socket.socket) -> None:
        source.settimeout(0.01)
        kept = bytearray()
        with suppress(OSError):
            while not self._ended:
                with suppress(TimeoutError):
                    received = source.recv(1 << 16)
                    if not received:
                        break
                    kept += received
                while kept and self._open.is_set():
                    sink.sendall(kept[:4096])
                    del kept[:4096]
                    if kept:
                        time.sleep(0.002)  # it has much to tell
