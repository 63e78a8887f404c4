"""go2_stand on platform `unitree`, against a process that looks like the robot: gates, kills."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("cyclonedds", reason="needs cyclonedds: pip install 'unicon_ros[hw-unitree]'")
pytest.importorskip("mujoco")

from unicon_ros.bench.domains import free_domain

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

ROBOT = Path(__file__).with_name("unitree_robot.py")
PLATFORM = "unicon_hardware.unitree.platform:make"
PATIENCE = 60.0
# Of the workflow, patient with a robot that a busy machine holds up.
SAFETY = "[finite, joint_limits, {stale_stop: {timeout: 2.0}}, {imu_stop: {timeout: 2.0}}]"


class Process:
    """A process, and what it wrote."""

    def __init__(self, folder: Path, name: str, command: list[str]) -> None:
        self.path = folder / f"{name}.txt"
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        with self.path.open("w") as file:
            self.process = subprocess.Popen(
                command, stdout=file, stderr=subprocess.STDOUT, env=environment
            )

    @property
    def text(self) -> str:
        return self.path.read_text()

    def said(self, key: str) -> dict[str, Any]:
        lines = [json.loads(line) for line in self.text.splitlines() if line.startswith("{")]
        return next((line for line in lines if key in line), {})

    def wait_for(self, text: str) -> None:
        end = time.monotonic() + PATIENCE
        while text not in self.text:
            assert time.monotonic() < end, self.text
            assert self.process.poll() is None, self.text
            time.sleep(0.02)

    def end(self, number: int) -> int:
        self.process.send_signal(number)
        return self.process.wait(PATIENCE)


@pytest.fixture
def domain() -> int:
    return free_domain()


@pytest.fixture
def robot(tmp_path: Path, domain: int) -> Iterator[Process]:
    made = Process(tmp_path, "robot", [sys.executable, str(ROBOT), "go2", str(domain), "rest"])
    made.wait_for("ready")
    yield made
    if made.process.poll() is None:
        made.process.kill()
        made.process.wait()


def run(folder: Path, name: str, domain: int, *more: str) -> Process:
    options = f"{{'{PLATFORM}': {{address: 127.0.0.1, domain: {domain}, silence: 1.0}}}}"
    sets = (f"platform={PLATFORM}", f"platforms={options}", "pacing.hang=20", f"safety={SAFETY}")
    command = [sys.executable, "-m", "unicon_ros", "run", "go2_stand", "--yes", *more]
    return Process(folder, name, command + [f"--set={each}" for each in sets])


def test_the_workflow_of_the_simulation_stands_the_robot_up_through_all_gates(
    robot: Process, domain: int, tmp_path: Path
) -> None:
    driven = run(tmp_path, "run", domain)
    assert driven.process.wait(120.0) == 0, driven.text
    assert robot.end(signal.SIGTERM) == 0
    assert "mode 'normal', to let go of the motors" in driven.text
    assert robot.said("first")["first"] <= 0.05
    end = robot.said("end")
    assert end["highest"] > 0.25
    assert end["place"][2] < 0.12  # it lies again
    assert end["stiffness"] == 0.0
    told = robot.said("refused")
    assert not told["refused"]
    assert told["asked"] == {"motion_switcher": [1001, 1003, 1001], "sport": [1005]}


def test_who_kills_the_run_finds_the_robot_where_it_was_and_starts_again(
    robot: Process, domain: int, tmp_path: Path
) -> None:
    first = run(tmp_path, "first", domain)
    robot.wait_for("first")
    time.sleep(2.0)
    assert first.end(signal.SIGKILL) == -signal.SIGKILL
    again = run(tmp_path, "again", domain)
    assert again.process.wait(120.0) == 0, again.text
    assert robot.end(signal.SIGTERM) == 0
    assert robot.said("end")["stiffness"] == 0.0
    assert robot.said("refused")["asked"]["motion_switcher"][-1] == 1001  # nothing to release


def test_a_robot_that_dies_ends_the_run_with_a_fault(
    robot: Process, domain: int, tmp_path: Path
) -> None:
    driven = run(tmp_path, "run", domain)
    robot.wait_for("first")
    robot.process.kill()
    assert driven.process.wait(PATIENCE) == 3
    assert "nothing from rt/lowstate of DDS domain" in driven.text
    assert "the robot is silent" in driven.text


def test_a_dry_run_sends_nothing(robot: Process, domain: int, tmp_path: Path) -> None:
    driven = run(tmp_path, "dry", domain, "--dry", "--duration=2")
    assert driven.process.wait(PATIENCE) == 0, driven.text
    assert "go2_stand on go2 (unitree)" in driven.text
    assert robot.end(signal.SIGTERM) == 0
    assert robot.said("end")["commands"] == 0
    assert robot.said("refused") == {"refused": {}, "asked": {}}
