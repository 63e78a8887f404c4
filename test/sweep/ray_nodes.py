"""A Ray cluster on this machine's loopback, a node at a time; for tests.

`ray start` takes 127.0.0.1 for the address that the machine has in its network, and would open
ports there: so its own look at that address is answered here.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import psutil

from unicon_base.resources import same_modules

START = """\
import sys
import ray._private.services as services
services.get_node_ip_address = lambda address=None: "127.0.0.1"
from ray.scripts.scripts import main
sys.argv[0] = "ray"
main()
"""
STARTED_S = 60.0
TOKEN = {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": "0123456789abcdef" * 4}
"""Environment of a node that joins."""


class Node:
    """One node of one CPU; the first is the head.

    Args:
        log: file for what it prints.
        address: of the head, "" to be one.
        folder: of Ray's files, for a head.

    Attributes:
        address: of the head.
    """

    def __init__(self, log: Path, address: str = "", folder: str = "") -> None:
        said = ["--block", "--node-ip-address", "127.0.0.1", "--num-cpus", "1"]
        said += ["--object-store-memory", "80000000", "--disable-usage-stats"]
        self.address = address or f"127.0.0.1:{_free_port()}"
        if address:
            said += ["--address", address]
        else:
            said += ["--head", "--port", self.address.rpartition(":")[2], "--temp-dir", folder]
            said += ["--include-dashboard", "false"]
        self._all: list[psutil.Process] = []
        with log.open("wb") as out:
            self._start = subprocess.Popen(
                [sys.executable, "-c", START, "start", *said],
                stdout=out, stderr=out, stdin=subprocess.DEVNULL, start_new_session=True,
                env=same_modules() | TOKEN,
            )  # fmt: skip
        until = time.monotonic() + STARTED_S
        while b"Ray runtime started" not in log.read_bytes():
            if self._start.poll() is not None or time.monotonic() > until:
                self.close()
                raise AssertionError(log.read_text())
            time.sleep(0.1)
        self._all = psutil.Process(self._start.pid).children(recursive=True)

    def processes(self, *names: str) -> list[psutil.Process]:
        """Return its processes whose command has one of some words."""
        alive = set(self._all)
        for each in self._all:
            with suppress(psutil.Error):
                alive |= set(each.children(recursive=True))
        return [
            each for each in alive if (said := _command(each)) and any(n in said for n in names)
        ]

    def kill(self, *names: str) -> int:
        """End such processes by SIGKILL; return how many there were."""
        found = self.processes(*names)
        for each in found:
            with suppress(psutil.Error):
                each.kill()
        return len(found)

    def close(self) -> None:
        """End all of it."""
        with suppress(psutil.Error):
            self._all += psutil.Process(self._start.pid).children(recursive=True)
        self._start.kill()
        self._start.wait()
        self.kill("")


def _command(process: psutil.Process) -> str:
    try:
        return " ".join(process.cmdline())
    except psutil.Error:
        return ""


def _free_port() -> int:
    """Return a port below those that the system gives away: Ray's other servers take such."""
    for port in range(20000 + os.getpid() % 5000, 32000):
        with socket.socket() as free, suppress(OSError):
            free.bind(("127.0.0.1", port))
            return port
    raise AssertionError("no port is free")


def left_of(folder: str) -> list[str]:
    """Return the commands of processes that work in a folder of Ray's."""
    return [command for each in psutil.process_iter() if folder in (command := _command(each))]
