"""Piped process: a module of ours that runs in another Python, with a line of JSON each way."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from unicon_core.resources import same_modules
from unicon_core.signals import signal_name
from unicon_ros.ending import die_with_parent, last_words


class PipedProcess:
    """A process that ends with us; what it prints goes to a log.

    Args:
        module: that it runs, with the numbers of two pipes: to read from and to write to.
        log: file for what it prints.
        environment: of it, besides ours.

    Attributes:
        pid: of it.
        log: the same.
        results: descriptor to read from; see `heard`.
        rows: descriptor to write to; see `write`.
        over: it has closed its end.
    """

    def __init__(self, module: str, log: Path, environment: Mapping[str, str]) -> None:
        self.log, self.over = log, False
        self._heard = b""
        theirs, self.rows = os.pipe()
        self.results, told = os.pipe()
        try:
            with log.open("wb") as file:
                self._process = subprocess.Popen(
                    [sys.executable, "-m", module, str(theirs), str(told)],
                    stdin=subprocess.DEVNULL,
                    stdout=file,
                    stderr=file,
                    pass_fds=[theirs, told],
                    env={**same_modules(), **environment},
                    start_new_session=True,  # Ctrl-C is ours
                    preexec_fn=die_with_parent if sys.platform == "linux" else None,
                )
        except BaseException:
            os.close(self.rows)
            os.close(self.results)
            raise
        finally:
            os.close(theirs)
            os.close(told)
        self.pid = self._process.pid

    def write(self, value: dict[str, Any]) -> None:
        """Tell it something; one that has died does not mind."""
        data = line_of(value)
        with suppress(BrokenPipeError):
            while data:
                data = data[os.write(self.rows, data) :]

    def heard(self) -> Iterator[dict[str, Any]]:
        """Yield what it has told; wait until there is something, or its end."""
        data = os.read(self.results, 1 << 16)
        self.over = not data
        *lines, self._heard = (self._heard + data).split(b"\n")
        yield from map(json.loads, lines)

    def close_rows(self) -> None:
        """Tell it that no more comes."""
        if self.rows >= 0:
            os.close(self.rows)
        self.rows = -1

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
        self.close_rows()
        os.close(self.results)
        how = f"ended by {signal_name(-status)}" if status < 0 else f"exit status {status}"
        return f"{how}: {last_words(self.log)}"


def line_of(value: dict[str, Any]) -> bytes:
    """Return a value as it goes through a pipe."""
    return (json.dumps(value, default=str) + "\n").encode()
