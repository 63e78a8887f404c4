"""`ros2 node|topic|service|param|lifecycle` beside a running node: ros2cli's own code, where it is
installed or its source is at hand (`their_clients.py`), else calls that equal its own."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from estop_platform import events
from robot_host import write_workflow
from their_clients import Clients

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.timeout(300)]

TRIGGER = "std_srvs/srv/Trigger"


@pytest.fixture
def node(
    ros2: Clients, started: Callable[..., Any], eventually: Callable[..., Any], tmp_path: Path
) -> Path:
    """A node that ticks on a robot that writes its commands down; return what is written."""
    path, log = write_workflow(tmp_path)
    process = started(ros2, "run", "unicon_ros", "unicon_node", *parameters(workflow=path))
    eventually(lambda: len(events(log, "send")) > 20, process.said)
    return log


def parameters(**values: Any) -> list[str]:
    """Return ROS arguments that set parameters."""
    return ["--ros-args", *(word for n, v in values.items() for word in ("-p", f"{n}:={v}"))]


def told(ros2: Clients, *words: str) -> str:
    """Return what a call that succeeds prints."""
    done = ros2.run(*words)
    assert done.returncode == 0, (ros2.whose, words, done.stdout, done.stderr)
    return done.stdout.strip()


def refused(ros2: Clients, *words: str) -> str:
    """Return what a call that fails says."""
    done = ros2.run(*words)
    assert done.returncode != 0 or "failed" in done.stdout + done.stderr, (words, done.stdout)
    return done.stdout + done.stderr


def triggered(ros2: Clients, service: str) -> bool:
    """Call a service of the node; return its success."""
    answer = told(ros2, "service", "call", f"/unicon/{service}", TRIGGER)
    assert "success=" in answer
    return "success=True" in answer


def test_node_and_topics_are_listed_with_their_types(node: Path, ros2: Clients) -> None:
    assert "/unicon" in told(ros2, "node", "list").splitlines()
    topics = told(ros2, "topic", "list", "-t").splitlines()
    for line in (
        "/joint_states [sensor_msgs/msg/JointState]",
        "/cmd_vel [geometry_msgs/msg/Twist]",
        "/tf_static [tf2_msgs/msg/TFMessage]",
        "/diagnostics [diagnostic_msgs/msg/DiagnosticArray]",
    ):
        assert line in topics, topics


def test_a_topic_is_echoed(node: Path, ros2: Clients) -> None:
    words = ("topic", "echo", "--once", "/joint_states", "sensor_msgs/msg/JointState")
    assert "FR_hip_joint" in told(ros2, *words)


def test_lifecycle_transitions_go_round(node: Path, ros2: Clients) -> None:
    assert told(ros2, "lifecycle", "get", "/unicon").startswith("active")
    for transition, state in (
        ("deactivate", "inactive"),
        ("cleanup", "unconfigured"),
        ("configure", "inactive"),
        ("activate", "active"),
    ):
        assert told(ros2, "lifecycle", "set", "/unicon", transition) == "Transitioning successful"
        assert told(ros2, "lifecycle", "get", "/unicon").startswith(state)
    assert "Unknown transition requested" in refused(ros2, "lifecycle", "set", "/unicon", "fly")
    assert told(ros2, "lifecycle", "get", "/unicon").startswith("active")
    assert len(events(node, "close")) == 1  # of the first run


def test_an_emergency_stop_latches_against_every_way_back(node: Path, ros2: Clients) -> None:
    assert triggered(ros2, "estop")
    assert len(events(node, "close")) == 1
    last = events(node, "send")[-1]
    assert not triggered(ros2, "start")
    state = told(ros2, "lifecycle", "get", "/unicon").split()[0]
    ways = {"inactive": ("activate",), "unconfigured": ("configure", "activate")}[state]
    answers = [ros2.run("lifecycle", "set", "/unicon", way) for way in ways]
    assert "failed" in answers[-1].stdout + answers[-1].stderr
    time.sleep(1.0)
    assert events(node, "send")[-1] == last
    assert triggered(ros2, "clear_estop")
    assert triggered(ros2, "start")
    assert told(ros2, "lifecycle", "get", "/unicon").startswith("active")


def test_parameters_are_read_set_and_refused(node: Path, ros2: Clients) -> None:
    assert "1.0" in told(ros2, "param", "get", "/unicon", "stiffness_scale")
    assert "successful" in told(ros2, "param", "set", "/unicon", "stiffness_scale", "0.8")
    assert "0.8" in told(ros2, "param", "get", "/unicon", "stiffness_scale")
    for name, value in (("stiffness_scale", "7.5"), ("speed", "warp"), ("autostart", "1.5")):
        assert "failed" in refused(ros2, "param", "set", "/unicon", name, value).lower()
    assert "0.8" in told(ros2, "param", "get", "/unicon", "stiffness_scale")
    assert told(ros2, "lifecycle", "get", "/unicon").startswith("active")
