"""A robot that writes every command and its closing to a file at once, for attacks on a run.

    platform: recording_robot:make
    platforms: {"recording_robot:make": {log: FILE, fault: NAME, at: TICK}}

Each line: `send TICK TIME_NS`, `damp TICK TIME_NS` of a command with less stiffness than the one
before, or `close TIME_NS`; what was written survives the process.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable

import numpy as np

from unicon_base.errors import Fault
from unicon_core.platforms.platform import SIMULATED, Facts
from unicon_core.robots import Robot
from unicon_core.runtime import phases
from unicon_core.states import States

# Each run waits for it at its end, in whose length no attack is interested.
phases.DAMPING_TIME = 0.1


class RecordingRobot:
    facts = Facts("recording", writes=SIMULATED)

    def __init__(
        self, states: States, robot: Robot, log: str, fault: str, where: str, at: int
    ) -> None:
        self._states, self._pose = states, np.nan_to_num(robot.rest_joint_pos)
        self._log = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        self._fault, self._where, self._at = FAULTS[fault], where, at
        self._ticks = 0
        self._stiffest = 0.0
        self._closed = False

    def recv(self) -> bool | None:
        self._states.joint_pos[...] = self._pose
        self._states.base_quat[...] = (1.0, 0.0, 0.0, 0.0)
        self._states.projected_gravity[...] = (0.0, 0.0, -1.0)
        self._states.stamp_ns[...] = time.monotonic_ns()
        self._now("recv")
        return None

    def send(self) -> bool | None:
        self._now("send")
        stiffness = float(self._states.joint_stiffness.max())
        word = "damp" if stiffness < self._stiffest else "send"
        self._stiffest = max(stiffness, self._stiffest)
        self._write(f"{word} {self._ticks} {time.monotonic_ns()}")
        self._ticks += 1
        return None

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            self._write(f"close {time.monotonic_ns()}")
            self._now("close", always=True)

    def _now(self, where: str, always: bool = False) -> None:
        if where == self._where and (always or self._ticks == self._at):
            self._write(f"fault {time.monotonic_ns()}")
            self._fault()

    def _write(self, line: str) -> None:
        os.write(self._log, f"{line}\n".encode())


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    log: str,
    fault: str = "none",
    where: str = "recv",
    at: int = 5,
) -> RecordingRobot:
    return RecordingRobot(states, robot, log, fault, where, at)


def _raise(error: BaseException) -> Callable[[], object]:
    def fault() -> None:
        raise error

    return fault


def _hang_in_python() -> None:
    """Hang so that neither a flag nor a swallowed exception ends it."""
    end = time.monotonic() + 30.0
    while time.monotonic() < end:
        time.sleep(0.01)


def _recurse() -> None:
    _recurse()


FAULTS: dict[str, Callable[[], object]] = {
    "none": lambda: None,
    "fault": _raise(Fault("the robot says so")),
    "value": _raise(ValueError("a value")),
    "memory": _raise(MemoryError()),
    "os": _raise(OSError(5, "Input/output error")),
    "recursion": _recurse,
    "exit": _raise(SystemExit(7)),
    "leave": lambda: os._exit(0),
    "interrupt": _raise(KeyboardInterrupt()),
    "shape": lambda: np.zeros(3) + np.zeros(4),
    "sleep": lambda: time.sleep(1.0),
    "hang": _hang_in_python,
    "flood": lambda: sys.stderr.write("x" * 100),
}
