"""Unitree's driver and our emulated robot against the official Python SDK, both directions.

UNICON_UNITREE_SDK names a checkout of unitreerobotics/unitree_sdk2_python, UNICON_UNITREE_PYTHON a
Python that has the cyclonedds it wants, 0.10.2, and NumPy. On cyclonedds 11 the SDK does not find
us: there its octets are another type.
"""

from __future__ import annotations

import json
import os
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="needs cyclonedds: pip install 'unicon_ros[hw-unitree]'")

from unitree_helpers import reader_of, states_of, until

from unicon_core.robots import load_robot
from unicon_core.states import States, standard_states
from unicon_core.states.layout import StateSpec
from unicon_core.states.standard import COMMAND_STATES, hardware_states
from unicon_hardware.unitree.face import face
from unicon_hardware.unitree.platform import UnitreeWire
from unicon_ros.bench.report import free_domain

# What these tests run against, the most that config/evidence.yaml may say by them.
EVIDENCE = "vendor"

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

COUNT = 2000
PEER = Path(__file__).with_name("unitree_sdk_peer.py")
ROBOTS = {"go": "go2", "hg": "g1_29dof"}


class Peer:
    """The SDK's process, and what it says."""

    def __init__(self, role: str, kind: str, domain: int) -> None:
        sdk, python = (os.environ.get(f"UNICON_UNITREE_{name}") for name in ("SDK", "PYTHON"))
        if not sdk or not python:
            pytest.skip(
                "UNICON_UNITREE_SDK does not name a checkout of unitree_sdk2_python, or "
                "UNICON_UNITREE_PYTHON a Python with cyclonedds 0.10.2 and NumPy"
            )
        self.process = subprocess.Popen(
            [python, str(PEER), role, kind, str(domain), str(COUNT)],
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": sdk},
        )
        self.said: list[dict[str, Any]] = []
        self._reading = threading.Thread(target=self._read)
        self._reading.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if line.startswith("{"):
                self.said.append(json.loads(line))

    def heard(self, key: str) -> dict[str, Any]:
        return next((words for words in self.said if key in words), {})

    def end(self) -> None:
        self.process.kill()
        self.process.wait()
        self._reading.join()


@pytest.fixture
def peers() -> Iterator[Callable[[str, str, int], Peer]]:
    made: list[Peer] = []

    def start(role: str, kind: str, domain: int) -> Peer:
        made.append(Peer(role, kind, domain))
        return made[-1]

    yield start
    for peer in made:
        peer.end()


def values(i: int, count: int) -> np.ndarray:
    """Return the numbers of message i, as the peer draws them."""
    return np.random.default_rng(i).standard_normal(count).astype(np.float32)


def measured(i: int, kind: str, n: int) -> dict[str, Any]:
    """Return what message i tells."""
    numbers = values(i, 3 * n + 10)
    quat = numbers[-10:-6].astype(np.float64)
    found = {
        "joint_pos": numbers[:n],
        "joint_vel": numbers[n : 2 * n],
        "joint_effort": numbers[2 * n : 3 * n],
        "base_quat": (quat / np.linalg.norm(quat)).astype(np.float32),
        "base_ang_vel": numbers[-6:-3],
        "base_lin_acc": numbers[-3:],
        "wireless_remote": [(i + k) % 256 for k in range(40)],
    }
    if kind == "go":
        found["motor_temperature"] = [(i + k) % 128 for k in range(n)]
        found["battery_charge"] = np.float32(0.01 * (i % 101))
        found["battery_voltage"] = 25.0 + i % 8
        found["foot_force"] = [i % 300, 2, -3, 4]
    else:
        found["motor_temperature"] = [max((i + k) % 100, (3 * i + k) % 100) for k in range(n)]
        found["motor_error"] = [i % 7] * n
    return found


def commanded(states: States, i: int, n: int) -> None:
    for name, row in zip(COMMAND_STATES, values(i, 5 * n).reshape(5, n)):
        states[name][...] = row


def whole(robot: Any) -> States:
    names = robot.joint_names
    more = {"foot_force": StateSpec((4,)), "wireless_remote": StateSpec((40,), "uint8")}
    return States(standard_states(names) | hardware_states(names) | more)


@pytest.mark.parametrize("kind", ["go", "hg"])
def test_the_sdk_as_robot_and_we_agree_on_every_message(
    kind: str, peers: Callable[[str, str, int], Peer]
) -> None:
    domain, robot = free_domain(), load_robot(ROBOTS[kind])
    peer = peers("robot", kind, domain)
    n, states = robot.num_joints, whole(robot)
    wire = UnitreeWire(states, robot, domain, "lo")
    try:
        until(lambda: peer.heard("ready") and wire.matched)
        until(lambda: reader_of(wire).sources)
        wire._mode[...] = 5  # what the robot would have told by now
        equal = 0
        for i in range(COUNT):
            commanded(states, i, n)
            wire.put()
            until(wire.take, lambda: wire.wait(0.2) or wire.put())
            told = measured(i, kind, n)
            equal += all(np.array_equal(states[key], value) for key, value in told.items())
        assert equal == COUNT
        assert wire.counts.good == COUNT
        assert not set(wire.counts.refused) - {"old tick"}  # of an answer that was sent again
        told = until(lambda: peer.heard("equal"))
        assert told == {"equal": COUNT, "crc": COUNT, "count": COUNT}
    finally:
        wire.close()


@pytest.mark.parametrize("kind", ["go", "hg"])
def test_the_sdk_as_controller_and_our_robot_agree_on_every_message(
    kind: str, peers: Callable[[str, str, int], Peer]
) -> None:
    domain, robot = free_domain(), load_robot(ROBOTS[kind])
    n, states = robot.num_joints, states_of(robot)
    made = face(states, robot, address="lo", domain=domain)
    peer = peers("controller", kind, domain)
    try:
        until(lambda: peer.heard("ready"), made.hear)
        modes = peer.heard("modes")["modes"]
        assert modes == [
            [0, {"form": "0", "name": "normal"}],
            [0, None],
            [0, {"form": "0", "name": ""}],
        ]
        until(lambda: made.matched and reader_of(made).sources)
        equal = 0
        wanted = states_of(robot)
        for i in range(COUNT):
            for key, value in measured(i, kind, n).items():
                if key in states:
                    states[key][...] = value
            made.remote[:] = bytes((i + k) % 256 for k in range(40))
            made.clock.count = (i - 1) % 2**32  # two are added
            made.tell()
            until(made.hear, lambda: reader_of(made).wait(1.0))
            commanded(wanted, i, n)
            equal += all(np.array_equal(states[key], wanted[key]) for key in COMMAND_STATES)
        assert equal == COUNT
        assert not made.counts.refused
        assert until(lambda: peer.heard("equal")) == {"equal": COUNT, "crc": COUNT, "count": COUNT}
    finally:
        made.close()
