"""What tests of Unitree's driver share: states, a face and a wire in one process, stepped."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from unicon_core.robots import Robot
from unicon_core.states import States, standard_states
from unicon_core.states.standard import hardware_states
from unicon_hardware.dds.end import DdsEnd
from unicon_hardware.dds.participant import Reader, Writer
from unicon_hardware.unitree.face import UnitreeEndpoint, face
from unicon_hardware.unitree.platform import UnitreeWire
from unicon_ros.bench.report import free_domain

# Of DDS: runs of the tests at the same time do not hear each other.
DOMAIN = free_domain()
LOOPBACK = "127.0.0.1"
PATIENCE = 10.0


def states_of(robot: Robot) -> States:
    names = robot.joint_names
    return States(standard_states(names) | hardware_states(names))


def until(condition: Callable[[], Any], step: Callable[[], Any] = lambda: None) -> Any:
    """Step until a condition holds, and return it."""
    end = time.monotonic() + PATIENCE
    while not (found := condition()):
        assert time.monotonic() < end, "it never came"
        step()
        time.sleep(0.001)
    return found


def reader_of(end: DdsEnd) -> Reader:
    """Return the reader of the first topic that it listens to."""
    return end._inlets[0]._reader


def writer_of(end: DdsEnd) -> Writer:
    """Return the writer of the first topic that it speaks on."""
    return end._outlets[0][0]


def encode_of(end: DdsEnd) -> Callable[[], bytes]:
    """Return what makes its messages."""
    return end._outlets[0][1]


class Pair:
    """A robot's face and our wire on one domain."""

    def __init__(self, robot: Robot, *, release: bool = False, **options: Any) -> None:
        self.robot = robot
        self.theirs, self.ours = states_of(robot), states_of(robot)
        rng = np.random.default_rng(2)
        self.theirs["joint_pos"][...] = rng.normal(size=robot.num_joints) * 0.1
        self.theirs["base_lin_acc"][...] = (0.1, 0.2, 9.8)
        options = {"mode": "normal" if release else ""} | options
        self.face: UnitreeEndpoint = face(self.theirs, robot, domain=DOMAIN, **options)
        self.wire = UnitreeWire(self.ours, robot, DOMAIN, LOOPBACK)
        if not release:
            self.wire._release = None
        until(self.wire.take, self.face.tell)
        until(lambda: self.wire.matched)

    def told(self) -> int:
        """Let the robot tell once, and take it."""
        self.face.tell()
        assert self.wire.wait(PATIENCE)
        return self.wire.take()

    def close(self) -> None:
        self.wire.close()
        self.face.close()
