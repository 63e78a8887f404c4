"""What the ROS tests share beside fixtures: peer processes, runs in a thread, waiting."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from unicon_core.runtime import Report, Runner, RunOptions
from unicon_core.workflow import Program, load_workflow
from unicon_ros.bridge import RosSession

SWAY = """\
schema: unicon.workflow/1
robot: go2
platform: mujoco
rate: 100
commands: [{velocity_command: {constant: [0.0, 0.0, 0.0]}}]
flow: {sway: {gains: {"*_thigh_joint": [0.6, 0, 0]}, time_constant: 0.1}}
safety: [finite, joint_limits]
"""
REACT = """\
schema: unicon.workflow/1
robot: go2
platform: fake
rate: 200
commands: [{velocity_command: {constant: [0.1, 0.0, 0.0]}}]
flow: {sway: {gains: {"*_hip_joint": [1.0, 0, 0]}, time_constant: 0.0}}
safety: [finite]
"""


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


class Run:
    """A workflow that ticks in a thread, with its bridge."""

    def __init__(self, path: Path, hooks: Any = (), duration: float = 60.0, **session: Any):
        self.warnings: list[str] = []
        self.session = RosSession(warn=self.warnings.append, **session)
        self.program: Program = load_workflow(path, hooks=[self.session.hook, *hooks])
        self.runner = Runner(self.program, RunOptions(duration=duration, warn=print))
        self.session.attach(self.runner)
        self.report: Report | None = None
        self._thread = threading.Thread(target=self._run)

    def _run(self) -> None:
        self.report = self.runner.run()

    def start(self) -> Run:
        """Begin to tick."""
        self._thread.start()
        return self

    def end(self) -> Report:
        """Stop, close and return the report."""
        self.runner.stop()
        self._thread.join(20)
        self.session.close()
        assert self.report is not None
        return self.report

    @property
    def alive(self) -> bool:
        """Whether it ticks."""
        return self._thread.is_alive()
