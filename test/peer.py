"""Processes that say JSON lines, and waiting for what they say, for tests of all rooms."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

__all__ = ["Peer", "wait_for"]


class Peer:
    """A process that says JSON lines.

    Attributes:
        lines: those that it has said.
        errors: what it has written to stderr.
    """

    def __init__(self, *command: str) -> None:
        self.lines: list[dict[str, Any]] = []
        environment = dict(os.environ)
        if command[0] != sys.executable:  # what the wheels set is of one interpreter only
            for name in ("_ROS_WHEELS_BOOTSTRAP_COMPLETE", "LD_LIBRARY_PATH", "AMENT_PREFIX_PATH"):
                environment.pop(name, None)
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=environment,
        )
        self.errors = ""
        self._threads = [threading.Thread(target=read) for read in (self._read, self._read_errors)]
        for thread in self._threads:
            thread.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if line.startswith("{"):
                self.lines.append(json.loads(line))

    def _read_errors(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.errors += line

    def tell(self, line: str) -> None:
        """Write a line to its standard input."""
        assert self.process.stdin is not None
        self.process.stdin.write(f"{line}\n")
        self.process.stdin.flush()

    def of(self, kind: str) -> list[dict[str, Any]]:
        """Return what was said of a kind."""
        return [line for line in self.lines if line.get("kind") == kind]

    def wait_for(self, condition: Callable[[], bool], what: str, timeout: float = 20.0) -> None:
        """Wait until a condition holds, or fail."""
        wait_for(condition, what, timeout)

    def end(self, timeout: float = 30.0) -> tuple[int, str]:
        """Wait for the process; return its exit status and what it wrote to stderr."""
        status = self.process.wait(timeout)
        for thread in self._threads:
            thread.join(timeout)
        return status, self.errors

    def kill(self) -> None:
        """SIGKILL."""
        self.process.kill()
        self.process.wait(10)


def wait_for(condition: Callable[[], bool], what: str, timeout: float = 20.0) -> None:
    """Wait until a condition holds, or fail."""
    end = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < end, f"waited {timeout} s for: {what}"
        time.sleep(0.01)
