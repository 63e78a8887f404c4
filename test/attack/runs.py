"""Runs of the command line as processes, on the recording robot, for attacks."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent

WORKFLOW = """\
robot: go2
platform: recording_robot:make
platforms:
  "recording_robot:make": {{log: {log}, {options}}}
rate: 50
start: none
{more}
flow: {{{flow}}}
"""

TOLD = "unicon: warning: start: {gates: false}: the robot is moved whatever it tells of itself\n"
"""What `start: none` tells at every start."""


@dataclass
class Run:
    """`unicon run` on a robot that logs what it is sent."""

    folder: Path
    options: str = "fault: none"
    flow: str = "hold: {}"
    more: str = ""
    arguments: list[str] = field(default_factory=lambda: ["--quiet"])
    hang: float | None = 10.0  # a busy machine may hold a process up; None: as users have it
    process: Any = None

    @property
    def log(self) -> Path:
        return self.folder / "commands.log"

    @property
    def report(self) -> dict[str, Any]:
        found: dict[str, Any] = json.loads((self.folder / "report.json").read_text())
        return found

    def start(self, report: bool = True, **streams: Any) -> Run:
        """Start it; modules beside its workflow file are importable."""
        path = self.folder / "attacked.yaml"
        more = self.more
        if self.hang is not None and "pacing:" not in more:
            more += f"\npacing: {{hang: {self.hang}}}"
        path.write_text(
            WORKFLOW.format(log=self.log, options=self.options, more=more, flow=self.flow)
        )
        command = [sys.executable, "-m", "unicon_ros", "run", str(path), "--no-ros"]
        command += ["--report", str(self.folder / "report.json")] if report else []
        command += self.arguments
        environment = dict(os.environ)
        if environment.pop("_ROS_WHEELS_BOOTSTRAP_COMPLETE", None) is not None:
            environment.pop("LD_LIBRARY_PATH", None)
        environment["PYTHONPATH"] = os.pathsep.join(map(str, (HERE, ROOT, self.folder)))
        streams.setdefault("stdout", subprocess.PIPE)
        streams.setdefault("stderr", subprocess.PIPE)
        self.process = subprocess.Popen(command, env=environment, **streams)
        return self

    def wait(self, timeout: float = 30.0) -> tuple[int, str, str]:
        """Return exit status, standard output and standard error."""
        try:
            out, err = self.process.communicate(timeout=timeout)
        except subprocess.TimeoutExpired:
            self.process.send_signal(signal.SIGCONT)
            self.process.kill()
            self.process.communicate()
            raise
        told = (err or b"").decode().replace(TOLD, "")
        return self.process.returncode, (out or b"").decode(), told

    def until(self, reached: Callable[[], bool], timeout: float = 20.0) -> None:
        """Wait until something holds; fail when the run ends first or takes too long."""
        end = time.monotonic() + timeout
        while not reached():
            if time.monotonic() > end or self.process.poll() is not None:
                self.process.kill()
                out, err = self.process.communicate()
                raise AssertionError(f"not reached; {out!r} {err!r}; log {self.lines()[-3:]}")
            time.sleep(0.01)

    def until_sent(self, count: int = 5) -> None:
        self.until(lambda: self.sent() >= count)

    def lines(self) -> list[list[str]]:
        if not self.log.exists():
            return []
        return [line.split() for line in self.log.read_text().splitlines()]

    def sent(self) -> int:
        return sum(line[0] == "send" for line in self.lines())

    def times(self, what: str) -> list[int]:
        return [int(line[-1]) for line in self.lines() if line[0] == what]

    @property
    def closed(self) -> bool:
        """Whether the robot was damped and closed, with no command after it."""
        words = [line[0] for line in self.lines()]
        return "close" in words and "send" not in words[words.index("close") :]
