"""A robot of joints that follow their targets, behind a vendor's face; in this or another process.

python test/hardware/emulated.py ROBOT.yaml module:face [option=value …]

It says JSON lines: `ready`, `first` with how far the first command is from where the joints are,
`damping` when commands have no stiffness left, and `silence` when they stop.
"""

from __future__ import annotations

import json
import math
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from unicon_core.platforms.fake import FakePlatform, make
from unicon_core.robots import Robot, load_robot
from unicon_core.states import States, standard_states
from unicon_core.states.standard import COMMAND_STATES, hardware_states
from unicon_hardware.endpoint import Endpoint

LEAN = 0.05  # [rad] from the default posture


def states_of(robot: Robot) -> States:
    return States({**standard_states(robot.joint_names), **hardware_states(robot.joint_names)})


def free_ports(count: int) -> list[int]:
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(count)]
    for one in sockets:
        one.bind(("127.0.0.1", 0))
    ports = [one.getsockname()[1] for one in sockets]
    for one in sockets:
        one.close()
    return ports


def moved(robot: Robot, **transport: Any) -> Robot:
    """Return the robot with other facts of its transport."""
    return replace(robot, transport={**robot.transport, **transport})


class Emulated:
    """The robot: hears, follows, tells."""

    def __init__(self, robot: Robot, face: str, **options: Any) -> None:
        self.states = states_of(robot)
        self._joints: FakePlatform = make(self.states, robot, 0.002, time_constant=0.05)
        self._joints.recv()
        lean = np.where(robot.default_joint_pos + LEAN < robot.upper, LEAN, -LEAN)
        self.states["joint_pos_target"][...] = robot.default_joint_pos + lean
        self.states["joint_stiffness"][...] = 1.0
        for _ in range(1000):
            self._joints.send()
        self._joints.recv()
        self.states["joint_stiffness"][...] = 0.0
        module, _, name = face.partition(":")
        self.face: Endpoint = getattr(import_module(module), name)(self.states, robot, **options)
        self.heard, self._random = 0, np.random.default_rng(1)
        self._stiff, self._last = False, -math.inf
        self.said: list[dict[str, Any]] = []

    def say(self, event: str, **what: Any) -> None:
        self.said.append({"event": event, **what})

    def step(self) -> None:
        if self.face.hear():
            if self._last < 0.0 or time.monotonic() - self._last > self.face.dead_man:
                off = np.abs(self.states["joint_pos_target"] - self.states["joint_pos"])
                self.say("first", distance=float(off.max()))
            self.heard, self._last = self.heard + 1, time.monotonic()
            stiff = bool(self.states["joint_stiffness"].any())
            if self._stiff and not stiff:
                self.say("damping", after=self.heard)
            self._stiff = stiff
        elif self.heard and time.monotonic() - self._last > self.face.dead_man and self._last > 0:
            self._last = -math.inf
            self.say("silence", commands=self.heard)
            self.states["joint_stiffness"][...] = 0.0
        if all(np.isfinite(self.states[name]).all() for name in COMMAND_STATES):
            self._joints.send()
        self._joints.recv()
        for name in ("base_ang_vel", "base_lin_acc"):
            self.states[name] += self._random.normal(scale=1e-3, size=3)
        self.face.now = time.monotonic()
        self.face.tell()


@contextmanager
def running(robot: Path, face: str, *options: str) -> Iterator[list[dict[str, Any]]]:
    """Start one in a process of its own; what it has said is there behind the block."""
    command = [sys.executable, __file__, str(robot), face, *options]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    said: list[dict[str, Any]] = []
    try:
        assert process.stdout is not None
        assert json.loads(process.stdout.readline())["event"] == "ready"
        yield said
    finally:
        process.kill()
        said += map(json.loads, process.communicate()[0].splitlines())


def main() -> None:
    robot, face, *options = sys.argv[1:]
    given = {key: value for key, _, value in (option.partition("=") for option in options)}
    emulated = Emulated(load_robot(Path(robot)), face, **given)
    emulated.say("ready")
    due = time.monotonic()
    while True:
        emulated.step()
        while emulated.said:
            print(json.dumps(emulated.said.pop(0)), flush=True)
        due += 1.0 / emulated.face.rate
        time.sleep(max(0.0, due - time.monotonic()))


if __name__ == "__main__":
    main()
