"""Piped process: a module of ours that runs in another Python, with JSON each way."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import suppress
from multiprocessing.connection import Connection, Pipe
from pathlib import Path
from typing import Any

from unicon_base.resources import same_modules
from unicon_core.signals import signal_name
from unicon_ros.process_exit import die_with_parent, last_log_line


class Line:
    """One end of the line between a process and its parent.

    Args:
        connection: to the other end; by default that of a process which a `PipedProcess` has begun.

    Attributes:
        connection: the same, for whoever waits for it.
        over: the other end is closed.
    """

    def __init__(self, connection: Connection | None = None) -> None:
        self.connection = connection or Connection(int(sys.argv[1]))
        self.over = False

    def write(self, value: dict[str, Any]) -> None:
        """Tell the other end something; one that has died does not mind."""
        with suppress(ConnectionError):
            self.connection.send_bytes(json.dumps(value, default=str).encode())

    def read(self) -> dict[str, Any]:
        """Return what the other end has told; wait until there is something, {} at its end."""
        with suppress(EOFError, OSError):
            value: dict[str, Any] = json.loads(self.connection.recv_bytes())
            return value
        self.over = True
        return {}


class PipedProcess(Line):
    """A process that ends with us; what it prints goes to a log.

    Args:
        module: that it runs, with the number of a descriptor: see `Line`.
        log: file for what it prints.
        environment: of it, besides ours.

    Attributes:
        pid: of it.
        log: the same.
    """

    def __init__(self, module: str, log: Path, environment: Mapping[str, str]) -> None:
        ours, theirs = Pipe()
        super().__init__(ours)
        self.log = log
        try:
            with theirs, log.open("wb") as file:
                self._process = subprocess.Popen(
                    [sys.executable, "-m", module, str(theirs.fileno())],
                    stdin=subprocess.DEVNULL,
                    stdout=file,
                    stderr=file,
                    pass_fds=[theirs.fileno()],
                    env={**same_modules(), **environment},
                    start_new_session=True,  # Ctrl-C is ours
                    preexec_fn=die_with_parent if sys.platform == "linux" else None,
                )
        except BaseException:
            ours.close()
            raise
        self.pid = self._process.pid

    def heard(self) -> Iterator[dict[str, Any]]:
        """Yield what it has told by now, once there is something; nothing at its end."""
        if told := self.read():
            yield told

    def wait(self, patience: float, ask: bool) -> None:
        """Let it end by itself within a time in [s]; ask for it by SIGTERM."""
        if ask:
            self._process.terminate()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(patience)

    def end(self) -> str:
        """End it; return how it did, in words."""
        with suppress(ProcessLookupError):  # also what it started, and what is stopped
            os.killpg(self.pid, signal.SIGKILL)
        status = self._process.wait()
        self.connection.close()
        how = f"ended by {signal_name(-status)}" if status < 0 else f"exit status {status}"
        return f"{how}: {last_log_line(self.log)}"
