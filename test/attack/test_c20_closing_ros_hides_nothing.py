"""A mistake while ROS is taken down costs neither the report nor the status, nor the rest of it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from unicon_base.errors import Fault
from unicon_core.platforms.fake import FakePlatform
from unicon_ros.bench.report import free_domain
from unicon_ros.bridge import RosSession
from unicon_ros.bridge.own_node import OwnNode
from unicon_ros.bridge.topics import TopicIn
from unicon_ros.cli.main import main

pytestmark = [pytest.mark.ros, pytest.mark.timeout(120)]

FALLS = """\
robot: go2
platform: fake
rate: 50
pacing: {hang: 10}
commands: [{velocity_command: {constant: [0.1, 0.0, 0.0]}}]
flow: {sway: {gains: {"*_hip_joint": [1.0, 0, 0]}, time_constant: 0.0}}
safety: [finite]
"""


@pytest.fixture(autouse=True)
def domain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(free_domain()))


def test_a_fault_stays_one_where_ros_cannot_be_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "falls.yaml").write_text(FALLS)
    close = RosSession.close

    def fail(session: RosSession) -> None:
        close(session)
        raise RuntimeError("the middleware is gone")

    def silent(platform: FakePlatform) -> None:
        raise Fault("the robot is silent")

    monkeypatch.setattr(RosSession, "close", fail)
    monkeypatch.setattr(FakePlatform, "recv", silent)
    report = tmp_path / "report.json"
    command = ["run", str(tmp_path / "falls.yaml"), "--ros", "--quiet", "--report", str(report)]
    assert main([*command, "--duration", "1"]) == 3
    assert json.loads(report.read_text())["ended"] == "fault"


def test_what_comes_after_a_mistake_is_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(topic: TopicIn) -> None:
        raise RuntimeError("the middleware is gone")

    closed: list[OwnNode] = []
    close = OwnNode.close
    monkeypatch.setattr(OwnNode, "close", lambda own: (closed.append(own), close(own)))
    monkeypatch.setattr(TopicIn, "close", fail)
    (tmp_path / "falls.yaml").write_text(FALLS)
    main(["run", str(tmp_path / "falls.yaml"), "--ros", "--quiet", "--duration", "0.1"])
    assert closed
