"""What the ROS tests share beside fixtures: workflows, and runs in a thread."""

from __future__ import annotations

import threading
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
