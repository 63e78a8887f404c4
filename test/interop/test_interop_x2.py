"""An AgiBot X2 behind platform `ros`: a whole run against a plain robot with the vendor's types."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")

from talkers import ROOT, Talker, clean_environment

from unicon_core.robots import load_robot

EVIDENCE = "stand_in"
"""What these tests run against, the most that config/evidence.yaml may say by them."""

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.timeout(1500)]

WORKFLOW = """\
schema: unicon.workflow/1
robot: {folder}/x2.yaml
platform: ros
platforms: {ros: {map: patient.yaml, connect: 60.0}}
rate: 50
duration: 4
start: {operator: false}
flow: {pose: {to: stand, duration: 2.0}}
safety: {only: [finite]}  # a busy machine may hold a process up
pacing: {trigger: state, hang: 20.0}
"""


@pytest.fixture
def workflow(tmp_path: Path) -> Path:
    """The robot file with the pose that it leaves open, and the map with longer time-outs."""
    text = (ROOT / "config" / "robots" / "x2.yaml").read_text(encoding="utf-8")
    text = text.replace("default: null", "default: 0.0").replace(
        "unknown: [joints.default, ", "unknown: ["
    )
    (tmp_path / "x2.yaml").write_text(text, encoding="utf-8")
    text = (ROOT / "config" / "maps" / "agibot_x2.yaml").read_text(encoding="utf-8")
    (tmp_path / "patient.yaml").write_text(text.replace("timeout: 0.05", "timeout: 5.0"))
    path = tmp_path / "x2_stand.yaml"
    path.write_text(WORKFLOW.replace("{folder}", str(tmp_path)), encoding="utf-8")
    return path


@pytest.fixture
def peer(type_support: dict[str, str]) -> Iterator[Talker]:
    """The robot, with its own controller still there."""
    robot = load_robot("x2")
    names, words = list(robot.joint_names), []
    for group, size in robot.transport["groups"].items():
        words.append(f"{group}={','.join(names[:size])}")
        names = names[size:]
    talker = Talker("x2_robot", *words, variables=type_support)
    yield talker
    talker.kill()


def test_it_waits_for_the_native_controller_then_stands_and_damps(
    peer: Talker, workflow: Path, type_support: dict[str, str]
) -> None:
    robot = load_robot("x2")
    environment = clean_environment() | type_support
    command = [sys.executable, "-m", "unicon_ros", "run", str(workflow)]
    run = subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    said: list[str] = []

    def heard() -> dict[str, Any]:
        return peer.of("robot")[-1]

    try:
        peer.wait(lambda: peer.of("robot"), "the robot", 60.0)
        assert run.stdout is not None
        for line in run.stdout:
            said.append(line)
            if "others send to /aima/hal/joint/leg/command" in line:
                assert heard()["commands"] == 0
                peer.tell(release=True)
        assert run.wait(60) == 0, "".join(said)
    finally:
        run.kill()
    assert any("others send to /aima/hal/joint/leg/command" in line for line in said), said
    commanded = set(robot.joint_names) - set(robot.transport["not_commanded"])
    peer.wait(lambda: set(heard()["gains"]) == set(robot.joint_names), "every joint")
    last = heard()
    assert max(last["first"][joint] for joint in commanded) < 0.05  # from where each joint was
    for joint, (stiffness, damping) in last["gains"].items():
        assert stiffness == 0.0
        assert (damping > 0.0) == (joint in commanded), joint
