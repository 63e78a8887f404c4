"""`unicon pub` and `unicon call` reach a node over DDS, and say what they lack in one line."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="no ROS 2: pip install 'unicon_ros[ros]'")

from geometry_msgs.msg import PoseStamped, PoseWithCovariance, Twist
from nav_msgs.msg import Path
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from unicon_base.errors import UniconError
from unicon_ros.bridge.own_node import OwnNode
from unicon_ros.cli import talk
from unicon_ros.cli.main import main

CLI = "import sys; from unicon_ros.cli.main import main; sys.exit(main(sys.argv[1:]))"


@pytest.fixture
def peer() -> Iterator[OwnNode]:
    own = OwnNode("unicon", None, ())
    yield own
    own.close()


def run_beside(peer: OwnNode, *arguments: str) -> tuple[int, str, str]:
    """Run the command as a process while the peer is spun."""
    process = subprocess.Popen(
        [sys.executable, "-c", CLI, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    end = time.monotonic() + 60.0
    while process.poll() is None and time.monotonic() < end:
        peer.executor.spin_once(0.02)
    out, err = process.communicate(timeout=1.0)
    return process.returncode, out, err


def test_a_topic_gets_what_is_published_in_the_type_that_it_has(peer: OwnNode) -> None:
    got: list[Twist] = []
    peer.node.create_subscription(Twist, "/cmd_vel", got.append, 10)
    status, out, err = run_beside(
        peer, "pub", "cmd_vel", "{linear: {x: 0.3}, angular: {z: 1}}", "--rate", "50",
        "--duration", "0.3",
    )  # fmt: skip
    assert status == 0, err
    assert 14 <= int(out.split()[0]) <= 16
    assert len(got) >= 5
    assert (got[-1].linear.x, got[-1].linear.y, got[-1].angular.z) == (0.3, 0.0, 1.0)


def test_a_field_that_is_not_there_is_named(peer: OwnNode) -> None:
    peer.node.create_subscription(Twist, "/cmd_vel", print, 10)
    status, _, err = run_beside(peer, "pub", "cmd_vel", "{linear: {q: 0.3}}", "--once")
    assert status == 1
    assert "no field 'linear.q'" in err
    assert "Traceback" not in err


@pytest.mark.parametrize("success", [True, False])
def test_a_service_answers_and_its_success_is_the_exit_status(peer: OwnNode, success: bool) -> None:
    asked: list[Any] = []

    def stop(_: Any, response: Any) -> Any:
        asked.append(True)
        response.success, response.message = success, "winds down"
        return response

    peer.node.create_service(Trigger, "~/stop", stop)
    status, out, err = run_beside(peer, "call", "stop")
    assert (status, out.strip()) == (0 if success else 1, "winds down"), err
    assert len(asked) == 1


def test_nobody_there_is_one_line_with_the_remedy(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(talk, "PATIENCE", 0.2)
    assert main(["pub", "nowhere", "{}", "--once"]) == 1
    assert "nobody listens to /nowhere after 0.2 s" in capsys.readouterr().err
    assert main(["call", "/nowhere/stop"]) == 1
    assert "no service /nowhere/stop after 0.2 s" in capsys.readouterr().err


def test_fields_are_set_as_deep_as_they_are_and_wrong_ones_refused() -> None:
    pose = talk.filled(
        PoseStamped(), {"header": {"frame_id": "map"}, "pose": {"position": {"x": 2}}}
    )
    assert (pose.header.frame_id, pose.pose.position.x) == ("map", 2.0)
    joints = talk.filled(JointState(), {"name": ["a", "b"], "position": [1, 2.5]})
    assert (joints.name, list(joints.position)) == (["a", "b"], [1.0, 2.5])
    pose_with = talk.filled(PoseWithCovariance(), {"covariance": [1] * 36})
    assert pose_with.covariance.tolist() == [1.0] * 36
    path = talk.filled(Path(), {"poses": [{"pose": {"position": {"z": 1}}}]})
    assert path.poses[0].pose.position.z == 1.0
    for values in (
        {"header": {"frame_id": 3}},
        {"pose": 3},
        [1],
        {"pose": {"position": {"x": "a"}}},
    ):
        with pytest.raises(UniconError):
            talk.filled(PoseStamped(), values)
