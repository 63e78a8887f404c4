"""`ros2 launch unicon_ros unicon.launch.py`: launch's own code, installed or from source
(`their_clients.py`), else a parent that starts what launch starts, and ends as it does."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from estop_platform import events
from robot_host import write_workflow
from their_clients import Clients

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.timeout(300)]

LAUNCH = ("launch", "unicon_ros", "unicon.launch.py")


@pytest.fixture
def robot(tmp_path: Path) -> tuple[Path, Path]:
    """A workflow on a robot that writes its commands down, and that file."""
    return write_workflow(tmp_path)


@pytest.fixture
def theirs(ros2_launch: Clients) -> Clients:
    """`ros2 launch` itself: what it reads and refuses cannot be imitated."""
    if ros2_launch.whose == "equal":
        pytest.skip("launch is neither installed nor its source named (UNICON_LAUNCH, …)")
    return ros2_launch


def nodes_of(domain: int) -> list[int]:
    """Return the processes of unicon_node in a domain, from /proc."""
    found = []
    for each in Path("/proc").glob("[0-9]*"):
        try:
            words = (each / "cmdline").read_bytes().split(b"\0")
            variables = (each / "environ").read_bytes().split(b"\0")
        except OSError:
            continue
        ours = any(word.endswith(b"/unicon_node") for word in words)
        if ours and f"ROS_DOMAIN_ID={domain}".encode() in variables:
            found.append(int(each.name))
    return found


@pytest.mark.skipif(sys.platform != "linux", reason="prctl is Linux's")
@pytest.mark.parametrize("signum", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_whatever_ends_the_launch_ends_the_node_damped(
    ros2_launch: Clients,
    robot: tuple[Path, Path],
    started: Callable[..., Any],
    eventually: Callable[..., Any],
    domain: int,
    signum: signal.Signals,
) -> None:
    path, log = robot
    launch = started(ros2_launch, *LAUNCH, f"workflow:={path}")
    eventually(lambda: len(events(log, "send")) > 20, launch.said)
    assert nodes_of(domain)
    os.kill(launch.pid, signum)  # of launch alone: Ctrl-C in a terminal reaches all
    eventually(lambda: not nodes_of(domain), launch.said)
    assert len(events(log, "close")) == 1, launch.said()
    assert events(log, "close")[0] > events(log, "send")[-1]
    launch.wait(20)
    assert "Traceback" not in launch.said()


def test_namespace_and_workflow_of_the_launch_are_the_node_s(
    ros2_launch: Clients,
    ros2: Clients,
    robot: tuple[Path, Path],
    started: Callable[..., Any],
    eventually: Callable[..., Any],
) -> None:
    path, log = robot
    launch = started(ros2_launch, *LAUNCH, f"workflow:={path}", "namespace:=robot1")
    eventually(lambda: len(events(log, "send")) > 20, launch.said)
    assert "/robot1/unicon" in ros2.run("node", "list").stdout.splitlines()
    told = ros2.run("param", "get", "/robot1/unicon", "workflow")
    assert str(path) in told.stdout, told.stderr
    topics = ros2.run("topic", "list", "-t").stdout
    assert "/robot1/joint_states [sensor_msgs/msg/JointState]" in topics


def test_arguments_are_shown(theirs: Clients) -> None:
    done = theirs.run(*LAUNCH, "--show-args")
    assert done.returncode == 0, done.stderr
    for name in ("workflow", "map", "namespace", "frame_prefix", "autostart", "record", "remap"):
        assert f"'{name}':" in done.stdout


@pytest.mark.parametrize("argument", ["rviz:=maybe", "remap:=cmd_vel", "autostart:=perhaps"])
def test_a_wrong_argument_starts_nothing(
    theirs: Clients, robot: tuple[Path, Path], argument: str, domain: int
) -> None:
    path, log = robot
    done = theirs.run(*LAUNCH, f"workflow:={path}", argument)
    assert done.returncode != 0
    assert argument.split(":=")[0] in done.stdout + done.stderr
    assert not log.exists()
    assert not nodes_of(domain)
