"""Runs on platforms over DDS, against a process that looks like the robot: gates, end, kill."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="needs cyclonedds: pip install 'unicon_ros[hw-pnd]'")

from unicon_core.robots import load_robot
from unicon_ros.bench.domains import free_domain

pytestmark = [pytest.mark.slow, pytest.mark.timeout(200)]

ROBOT = Path(__file__).with_name("dds_robot.py")
PACKAGE = "unicon_hardware"
WORKFLOW = """
schema: unicon.workflow/1
name: posture
robot: {robot}
platform: "{platform}"
platforms: {{"{platform}": {{address: 127.0.0.1, domain: {domain}, silence: 1.0}}}}
rate: 50
duration: 30
pacing: {{hang: 20}}
flow:
  chain:
    - pose: {{to: {there}, duration: 1.5}}
    - hold: {{duration: 1.5}}
safety: [finite, joint_limits]
"""
# Robot to the modules of its driver and of its end.
CASES = {
    "adam_lite": ("pnd.platform", "pnd.face"),
    "dex3_left": ("unitree_dex3.platform", "unitree_dex3.face"),
    "inspire_rh56_ftp_left": ("inspire.platform", "inspire.dds.face"),
    "inspire_rh56_dfx_right": ("inspire.platform", "inspire.dds.face"),
}


class Served:
    """An emulated robot, and runs on it."""

    def __init__(self, name: str, folder: Path) -> None:
        self.robot, self.domain = load_robot(name), free_domain()
        platform, face = (f"{PACKAGE}.{module}" for module in CASES[name])
        command = [sys.executable, str(ROBOT), name, face, str(self.domain)]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        assert "ready" in self.process.stdout.readline()
        there = {"adam_lite": "default"}.get(name, json.dumps(self.bent()))
        self.workflow = folder / "posture.yaml"
        said = {"robot": name, "platform": f"{platform}:make"}
        self.workflow.write_text(WORKFLOW.format(**said, domain=self.domain, there=there))

    def bent(self) -> dict[str, float]:
        names, middle = self.robot.joint_names, (self.robot.lower + self.robot.upper) / 2
        return {name: float(value) for name, value in zip(names, middle, strict=True)}

    def run(self, *more: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", "unicon_ros", "run", str(self.workflow), "--yes", *more]
        return subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )

    def end(self) -> dict[str, Any]:
        self.process.send_signal(signal.SIGTERM)
        out, _ = self.process.communicate(timeout=60)
        lines: dict[str, Any] = {}
        for line in out.splitlines():
            lines |= json.loads(line)
        return lines


@pytest.fixture
def served(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Served]:
    made = Served(request.param, tmp_path)
    yield made
    if made.process.poll() is None:
        made.process.kill()
        made.process.communicate()


@pytest.mark.parametrize("served", CASES, indirect=True)
def test_a_posture_is_reached_and_the_robot_is_limp_at_the_end(served: Served) -> None:
    driven = served.run()
    out, _ = driven.communicate(timeout=120)
    assert driven.returncode == 0, out
    told = served.end()
    assert told["first"] <= 0.05
    goal = served.robot.default_joint_pos
    if served.robot.name != "adam_lite":
        goal = (served.robot.lower + served.robot.upper) / 2
    np.testing.assert_allclose(told["end"], goal, atol=0.05)
    assert told["stiffness"] == 0.0
    assert told["refused"] == {}


@pytest.mark.parametrize("served", ["adam_lite"], indirect=True)
def test_either_side_may_be_killed(served: Served) -> None:
    first = served.run()
    assert served.process.stdout is not None
    assert "first" in served.process.stdout.readline()
    first.send_signal(signal.SIGKILL)
    first.communicate(timeout=60)
    again = served.run()
    out, _ = again.communicate(timeout=120)
    assert again.returncode == 0, out
    third = served.run()
    served.process.kill()
    out, _ = third.communicate(timeout=120)
    assert third.returncode in (1, 3), out
    assert "rt/lowstate of DDS domain" in out
