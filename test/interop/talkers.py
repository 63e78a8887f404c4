"""Processes that are told and tell JSON lines, for the interoperability tests."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent


def clean_environment() -> dict[str, str]:
    """Return the environment without what the wheels' bootstrap leaves to child processes.

    Another venv would load the wrong libraries.
    """
    values = dict(os.environ)
    if values.pop("_ROS_WHEELS_BOOTSTRAP_COMPLETE", None) is not None:
        values.pop("LD_LIBRARY_PATH", None)
    return values


class Talker:
    """A process of `processes/`.

    Args:
        script: its name.
        arguments: of its command line.
        python: interpreter that runs it.
        variables: environment variables besides ours.
    """

    def __init__(
        self,
        script: str,
        *arguments: str,
        python: str = sys.executable,
        variables: Mapping[str, str] | None = None,
    ) -> None:
        environment = clean_environment()
        environment.setdefault("PYTHONPATH", str(ROOT))
        environment.update(variables or {})
        self.lines: list[dict[str, Any]] = []
        self.errors = ""
        self.process = subprocess.Popen(
            [python, str(HERE / "processes" / f"{script}.py"), *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=environment,
        )
        for read in (self._read, self._read_errors):
            threading.Thread(target=read, daemon=True).start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if line.startswith("{"):
                self.lines.append(json.loads(line))

    def _read_errors(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.errors += line

    def tell(self, **order: Any) -> None:
        """Send one order."""
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(order) + "\n")
        self.process.stdin.flush()

    def of(self, kind: str, **values: Any) -> list[dict[str, Any]]:
        """Return the lines of a kind with these values."""
        return [
            line
            for line in list(self.lines)
            if line["kind"] == kind and all(line.get(k) == v for k, v in values.items())
        ]

    def wait(
        self,
        condition: Callable[[], Any],
        what: str,
        timeout: float = 20.0,
        again: Callable[[], object] | None = None,
    ) -> Any:
        """Wait until a condition is true and return it; `again` is called twice a second."""
        end, next_time = time.monotonic() + timeout, 0.0
        while not (found := condition()):
            now = time.monotonic()
            assert self.process.poll() is None, f"the process ended: {self.errors}"
            assert now < end, f"waited {timeout} s for: {what}\n{self.errors}"
            if again is not None and now >= next_time:
                next_time = now + 0.5
                again()
            time.sleep(0.01)
        return found

    def ready(self) -> Talker:
        """Wait until it is."""
        self.wait(lambda: self.of("ready"), "the process to be ready", 30.0)
        return self

    def end(self) -> int:
        """Close its stdin and return its exit status."""
        assert self.process.stdin is not None
        if not self.process.stdin.closed:
            self.process.stdin.close()
        return self.process.wait(20)

    def kill(self) -> None:
        """SIGKILL."""
        self.process.kill()
        self.process.wait(10)
