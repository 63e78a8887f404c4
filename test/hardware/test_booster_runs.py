"""Runs on platform `booster` against our emulated T1, as processes: gates, posture, kills."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator

import pytest

pytest.importorskip("cyclonedds", reason="needs cyclonedds: pip install 'unicon_ros[hw-booster]'")
pytest.importorskip("mujoco")

from peer import Peer

from unicon_ros.bench.domains import free_domain

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

UNICON = (sys.executable, "-m", "unicon_ros")
PACKAGE = "unicon_hardware.booster"
PLATFORM = f"{PACKAGE}.platform:make"
# How far a first command may be from where the joints are, [rad].
FIRST = 0.05
# Patient with a robot that a busy machine holds up.
SAFETY = "[finite, joint_limits, {stale_stop: {timeout: 2.0}}, {imu_stop: {timeout: 2.0}}]"
Start = Callable[..., Peer]


@pytest.fixture
def start() -> Iterator[Start]:
    made: list[Peer] = []

    def process(*command: str) -> Peer:
        made.append(Peer(*UNICON, *command))
        return made[-1]

    yield process
    for peer in made:
        if peer.process.poll() is None:
            peer.kill()
        peer.end()


def emulated(start: Start, assets: object, domain: int) -> Peer:
    robot = start(
        "emulate", "t1", f"--face={PACKAGE}.face:face", f"--set=domain={domain}", "--hang"
    )
    robot.wait_for(
        lambda: bool(robot.of("ready")) or robot.process.poll() is not None, "the robot", 60.0
    )
    assert robot.of("ready"), robot.end()
    return robot


def run(start: Start, domain: int, *more: str, child: bool = False) -> Peer:
    options = f"{{'{PLATFORM}': {{address: 127.0.0.1, domain: {domain}, silence: 1.0}}}}"
    platform = f"{{child: {PLATFORM}}}" if child else PLATFORM
    sets = (f"platform={platform}", "robot=t1", f"platforms={options}", f"safety={SAFETY}")
    given = [f"--set={one}" for one in (*sets, "pacing.hang=20", "rate=50")]
    return start("run", "h1_stand", "--yes", *given, *more)


def test_a_posture_is_held_after_a_kill_and_given_back(start: Start, assets: object) -> None:
    domain = free_domain()
    robot = emulated(start, assets, domain)
    killed = run(start, domain)
    robot.wait_for(lambda: bool(robot.of("commands")), "commands", 90.0)
    killed.kill()
    robot.wait_for(lambda: bool(robot.of("silence")), "silence", 30.0)
    again = run(start, domain, "--duration=3")
    status, errors = again.end(90.0)
    assert status == 0, errors
    robot.wait_for(lambda: robot.of("damping")[-1:] != [], "damping")
    assert [first["distance"] <= FIRST for first in robot.of("first")] == [True, True]
    os.kill(robot.process.pid, signal.SIGTERM)
    robot.end()
    assert not robot.of("refused")


def test_a_child_damps_a_robot_whose_run_is_killed_and_a_lost_robot_is_a_fault(
    start: Start, assets: object
) -> None:
    domain = free_domain()
    robot = emulated(start, assets, domain)
    killed = run(start, domain, child=True)
    robot.wait_for(lambda: bool(robot.of("commands")), "commands", 90.0)
    killed.kill()
    robot.wait_for(lambda: bool(robot.of("damping")), "damping", 30.0)
    robot.kill()
    domain = free_domain()
    robot = emulated(start, assets, domain)
    left = run(start, domain)
    robot.wait_for(lambda: bool(robot.of("commands")), "commands", 90.0)
    robot.kill()
    status, errors = left.end(60.0)
    assert status == 3, errors
