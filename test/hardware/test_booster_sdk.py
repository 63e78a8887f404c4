"""Our emulated T1 and our wire against the vendor's booster_robotics_sdk_python, on loopback.

UNICON_BOOSTER_SDK names a folder where the package (1.6.3) is installed for this Python. As robot
the vendor's code needs its headers too: UNICON_BOOSTER_HEADERS names the folder `include` of a
checkout of BoosterRobotics/booster_robotics_sdk (d5d8f7a).
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="needs cyclonedds: pip install 'unicon_ros[hw-booster]'")

from dds_ends import whole_states
from peer import Peer
from test_booster import T1
from unitree_helpers import until

from unicon_core.platforms.kit.base import quat_of_rpy
from unicon_core.states.standard import BUTTONS
from unicon_hardware.booster.codec import BoosterFacts
from unicon_hardware.booster.platform import BoosterWire
from unicon_hardware.booster.takeover import face
from unicon_hardware.dds.maps import command_arrays
from unicon_ros.bench.report import free_domain

# What these tests run against, the most that config/evidence.yaml may say by them.
EVIDENCE = "vendor"

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

COUNT, N = 2000, T1.num_joints
HERE = Path(__file__).resolve().parent
TELLS = ("joint_pos", "joint_vel", "joint_effort")
ORDER = ("joint_pos_target", "joint_vel_target", "joint_effort_ff", "joint_stiffness")
ORDER += ("joint_damping",)


def said(vendor: Peer, key: str) -> Any:
    """Return what it said of a thing, None before."""
    return next((line[key] for line in vendor.lines if key in line), None)


def values(i: int, count: int) -> np.ndarray:
    return np.random.default_rng(i).standard_normal(count).astype(np.float32)


@pytest.fixture
def start(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Peer]]:
    """Start one of the vendor's programs, with what is given."""
    sdk = os.environ.get("UNICON_BOOSTER_SDK")
    if not sdk:
        pytest.skip("UNICON_BOOSTER_SDK names no folder with booster_robotics_sdk_python")
    monkeypatch.setenv("PYTHONPATH", sdk)
    made: list[Peer] = []

    def process(program: str, *more: object) -> Peer:
        made.append(Peer(sys.executable, str(HERE / program), *map(str, more)))
        return made[-1]

    yield process
    for one in made:
        one.process.kill()
        one.end()


def test_as_controller_two_thousand_states_and_commands_are_equal(
    start: Callable[..., Peer],
) -> None:
    domain = free_domain()
    vendor = start("booster_sdk_peer.py", domain, COUNT)
    theirs, ours = whole_states(T1), whole_states(T1)
    robot = face(theirs, T1, domain=domain)
    wire = BoosterWire(ours, T1, domain, "127.0.0.1")
    raws: list[bytes] = []
    inlet = robot._inlets[0]
    read = inlet._read

    def seen(raw: bytes) -> bool:
        raws.append(raw)
        return read(raw)

    inlet._read = seen
    mine = command_arrays(N)
    encode = BoosterFacts.of(T1).command.encoder(mine).encode
    try:
        until(lambda: said(vendor, "mode_now") is not None, robot.hear)
        assert said(vendor, "there")
        assert said(vendor, "mode") == 1
        assert "502" in str(said(vendor, "early"))  # before any command
        assert said(vendor, "custom") == 0
        assert said(vendor, "mode_now") == 3
        assert robot.obeys
        until(lambda: robot._outlets[0][0].matched)
        equal = decoded = same = 0
        for i in range(COUNT):
            numbers = values(i, 3 * N + 6)
            for row, name in enumerate(TELLS):
                theirs[name][...] = numbers[row * N : (row + 1) * N]
            theirs["base_ang_vel"][...], theirs["base_lin_acc"][...] = numbers[-6:-3], numbers[-3:]
            roll = i / 1000.0
            theirs["base_quat"][...] = (np.cos(roll / 2), np.sin(roll / 2), 0, 0)
            theirs["motor_temperature"][...] = (i + np.arange(N)) % 100
            theirs["motor_error"][...] = (i * np.arange(N)) % 256
            wanted = values(i, 5 * N).reshape(5, N)

            def came(wanted: np.ndarray = wanted) -> bool:
                robot.hear()
                return bool((theirs["joint_pos_target"] == wanted[0]).all())

            robot.tell()
            again = time.monotonic() + 0.2
            while not came():
                if time.monotonic() > again:  # a message was lost
                    until(came, robot.tell)
            equal += all(
                np.array_equal(theirs[name], wanted[row]) for row, name in enumerate(ORDER)
            )
            for row, name in enumerate(ORDER):
                mine[name][...] = wanted[row]
            same += raws[-1].rstrip(b"\0") == encode().rstrip(b"\0")
            wire.take()
            decoded += all(np.array_equal(ours[name], theirs[name]) for name in TELLS)
        assert (equal, same, decoded) == (COUNT, COUNT, COUNT)
        until(lambda: said(vendor, "equal") is not None)
        assert (said(vendor, "equal"), said(vendor, "count")) == (COUNT, COUNT)
        until(lambda: ours["controls_alive"], wire.take)
        assert ours["sticks"].tolist() == [0.5, 1.0, 0.0, 0.0]
        held = {BUTTONS[k] for k in np.flatnonzero(ours["buttons"])}
        assert held == {"A", "R1", "up", "left"}
        assert wire.commanders() == {"rt/joint_ctrl": 1}
        assert not robot.counts.refused
        assert not wire.counts.refused
    finally:
        wire.close()
        robot.close()


def test_as_robot_two_thousand_states_and_commands_are_equal(
    start: Callable[..., Peer], tmp_path: Path
) -> None:
    headers = os.environ.get("UNICON_BOOSTER_HEADERS")
    if not headers:
        pytest.skip("UNICON_BOOSTER_HEADERS names no folder with the vendor's headers")
    library, domain = tmp_path / "booster_robot.so", free_domain()
    compiler = ("g++", "-std=c++17", "-O1", "-fPIC", "-shared", f"-I{headers}", "-o", library)
    subprocess.run([*compiler, HERE / "booster_robot.cpp"], check=True, timeout=200)
    vendor = start("booster_robot_peer.py", library, domain, COUNT)
    ours = whole_states(T1)
    wire = BoosterWire(ours, T1, domain, "127.0.0.1")
    try:
        until(lambda: wire.take() or vendor.process.poll() is not None)
        assert vendor.process.poll() is None, vendor.errors
        until(lambda: not wire.prepare(), wire.take)
        until(lambda: said(vendor, "mode") == 3)
        equal = 0
        for i in range(COUNT):
            numbers, imu = values(i, 4 * N).reshape(N, 4), values(i + 1, 8)
            until(lambda q=numbers[:, 0]: wire.take() and np.array_equal(ours["joint_pos"], q))
            wanted = np.array((i / 1000.0, *(np.float32(0.1) * imu[:2])))
            equal += (
                np.array_equal(ours["joint_vel"], numbers[:, 1])
                and np.array_equal(ours["joint_effort"], numbers[:, 3])
                and np.array_equal(ours["base_ang_vel"], imu[2:5])
                and np.array_equal(ours["base_lin_acc"], imu[5:8])
                and np.array_equal(ours["motor_temperature"], (i + np.arange(N)) % 100)
                and np.array_equal(ours["motor_error"], (i * np.arange(N)) % 256)
                and np.allclose(ours["base_quat"], quat_of_rpy(wanted), atol=1e-6)
            )
            for row, name in enumerate(ORDER):
                ours[name][...] = values(i, 5 * N).reshape(5, N)[row]
            wire.put()
        assert equal == COUNT
        until(lambda: said(vendor, "equal") is not None, wire.put)
        assert said(vendor, "equal") == COUNT
        assert not wire.counts.refused
    finally:
        wire.close()
    until(lambda: said(vendor, "left") is not None)
    assert said(vendor, "left") == 0  # damping
