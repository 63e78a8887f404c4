"""`ros2 launch unicon_ros unicon.launch.py`: launch's own code, installed or from source
(`their_clients.py`), else a parent that starts what launch starts, and ends as it does. What launch
alone can show is then tested by calls that equal its own in test_launch_orphan.py,
test_latches_outlive_processes.py and test_ros_parameters.py.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from estop_platform import events
from robot_host import write_workflow
from their_clients import Clients

from unicon_ros.parameter_table import DECLARED

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.timeout(300)]

LAUNCH = ("launch", "unicon_ros", "unicon.launch.py")
OWN = """\
from launch import LaunchDescription
from launch_ros.actions import Node

def generate_launch_description():
    return LaunchDescription([
        Node(package="unicon_ros", executable="unicon_node", output="screen", respawn=True,
             respawn_delay=0.5, parameters=[{{"workflow": {workflow!r}, "exit_on_fault": True}}])
    ])
"""
INCLUDING = """\
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource as Source
from launch.substitutions import PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare

def generate_launch_description():
    share = FindPackageShare("unicon_ros")
    ours = Source(PathJoinSubstitution([share, "launch", "unicon.launch.py"]))
    return LaunchDescription([
        DeclareLaunchArgument("robot_name", default_value="spot"),
        IncludeLaunchDescription(ours, launch_arguments={{
            "workflow": {workflow!r}, "namespace": "spot", "publish_lnk_tf": "false"}}.items()),
    ])
"""


@pytest.fixture
def robot(tmp_path: Path) -> tuple[Path, Path]:
    """A workflow on a robot that writes its commands down, and that file."""
    return write_workflow(tmp_path)


@pytest.fixture
def theirs(ros2_launch: Clients) -> Clients:
    """`ros2 launch` itself: what it reads and refuses cannot be imitated."""
    if ros2_launch.whose == "equal":
        pytest.skip("launch is neither installed nor its source named (UNICON_ROS2_SOURCE)")
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


def ticking(log: Path, eventually: Callable[..., Any], launch: Any) -> None:
    """Wait for more commands."""
    before = len(events(log, "send"))
    eventually(lambda: len(events(log, "send")) > before + 20, launch.said, 60.0)


def still(log: Path) -> int:
    """Return how many commands have left, once none does any more."""
    time.sleep(1.0)
    sent = len(events(log, "send"))
    time.sleep(1.0)
    assert len(events(log, "send")) == sent
    return sent


def interrupted(launch: Any) -> str:
    """Return what a launch has said that was ended by Ctrl-C."""
    launch.send_signal(signal.SIGINT)
    launch.wait(30)
    return str(launch.said())


def answer(ros2: Clients, service: str) -> str:
    done = ros2.run("service", "call", service, "std_srvs/srv/Trigger")
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_there_is_an_argument_for_each_parameter(theirs: Clients) -> None:
    done = theirs.run(*LAUNCH, "--show-args")
    assert done.returncode == 0, done.stderr
    for name in (*(name for name, *_ in DECLARED), "params_file", "name", "use_sim_time"):
        assert f"\n    '{name}':\n" in done.stdout


@pytest.mark.parametrize(
    ("argument", "said"),
    [
        ("workflw:=go2_stand", "no argument 'workflw'; did you mean workflow? known: "),
        ("colour:=red", "no argument 'colour'; known: autostart, "),
        ("rate:=fast", "argument rate:=fast: write a number"),
        ("record_jpeg:=much", "argument record_jpeg:=much: write a whole number"),
        ("autostart:=maybe", "argument autostart:=maybe: write true or false"),
        ("overrides:=rate=5", "argument overrides:=rate=5: write a list"),
        ("params_file:=/nowhere.yaml", "argument params_file:=/nowhere.yaml: "),
        ("name:=", "malformed launch argument 'name:='"),
        ("remap:=cmd_vel", "'cmd_vel' is not of the form from:=to"),
        ("rviz:=true", "leave rviz:=true out"),
    ],
)
def test_a_wrong_argument_starts_nothing(
    theirs: Clients, domain: int, argument: str, said: str
) -> None:
    done = theirs.run(*LAUNCH, argument)
    assert done.returncode == 1
    assert said in done.stdout + done.stderr
    assert "process started" not in done.stdout + done.stderr
    assert not nodes_of(domain)


def test_parameters_come_from_arguments_then_the_file(
    theirs: Clients, started: Callable[..., Any], eventually: Callable[..., Any], tmp_path: Path
) -> None:
    path, log = write_workflow(tmp_path)
    file = tmp_path / "parameters.yaml"
    file.write_text(
        f"/**/walker:\n  ros__parameters: {{workflow: {path}, rate: 60, max_vx: 1, force: []}}\n"
    )
    given = ("name:=walker", "namespace:=robot1", "max_vx:=0.5", "overrides:=['rate=40']")
    launch = started(theirs, *LAUNCH, f"params_file:={file}", *given)
    ticking(log, eventually, launch)
    node = "/robot1/walker"

    def get(name: str) -> str:
        done = theirs.run("param", "get", node, name)
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()

    assert get("rate") == "Double value is: 60.0"
    assert get("max_vx") == "Double value is: 0.5"
    assert get("overrides") == "String values are: ['rate=40']"

    def put(name: str, value: str) -> str:
        done = theirs.run("param", "set", node, name, value)
        return (done.stdout + done.stderr).strip()

    assert put("max_vx", "1") == "Set parameter successful"
    assert get("max_vx") == "Double value is: 1.0"
    assert put("overrides", "[]") == "Set parameter successful"
    assert "workflow: unknown workflow 'go2_stnd'; did you mean 'go2_stand'?" in put(
        "workflow", "go2_stnd"
    )
    assert theirs.run("lifecycle", "get", node).stdout.split()[0] == "active"
    assert "process has finished cleanly" in interrupted(launch)


def test_a_parameter_file_that_says_nothing_for_the_node_is_refused(
    theirs: Clients, tmp_path: Path
) -> None:
    file = tmp_path / "parameters.yaml"
    file.write_text("unicon:\n  ros__parameters: {rate: 60}\n")
    done = theirs.run(*LAUNCH, f"params_file:={file}", "namespace:=robot1")
    assert done.returncode == 1
    told = done.stdout + done.stderr
    assert "it has no parameters for node /robot1/unicon, but for /unicon; " in told


def test_no_respawn_gets_round_an_estop_and_a_fault(
    theirs: Clients,
    robot: tuple[Path, Path],
    started: Callable[..., Any],
    eventually: Callable[..., Any],
    tmp_path: Path,
    domain: int,
) -> None:
    path, log = robot
    own = tmp_path / "own.launch.py"
    own.write_text(OWN.format(workflow=str(path)))
    launch = started(theirs, "launch", str(own))
    ticking(log, eventually, launch)
    assert "success=True" in answer(theirs, "/unicon/estop")
    eventually(lambda: events(log, "close"), launch.said)
    sent = still(log)
    assert "the emergency stop is latched" in answer(theirs, "/unicon/start")
    life = ("lifecycle", "set", "/unicon")
    assert "Transitioning successful" in theirs.run(*life, "configure").stdout
    refused = theirs.run(*life, "activate")
    assert "Transitioning failed" in refused.stdout + refused.stderr
    assert still(log) == sent
    assert "success=True" in answer(theirs, "/unicon/clear_estop")
    assert "success=True" in answer(theirs, "/unicon/start")
    ticking(log, eventually, launch)
    # Launch is killed: the node ends with it, though the launch file says nothing of that.
    closed = len(events(log, "close"))
    launch.kill()
    eventually(lambda: len(events(log, "close")) > closed, launch.said)
    eventually(lambda: not nodes_of(domain), launch.said)
    said = launch.said()
    assert "process has died" in said
    assert "exit code 3" in said
    assert "not started by itself: " in said


def test_a_launch_file_that_includes_ours_keeps_its_own_arguments(
    theirs: Clients,
    robot: tuple[Path, Path],
    started: Callable[..., Any],
    eventually: Callable[..., Any],
    tmp_path: Path,
) -> None:
    path, log = robot
    own = tmp_path / "including.launch.py"
    own.write_text(INCLUDING.format(workflow=str(path)))
    launch = started(theirs, "launch", str(own), "robot_name:=rex")
    ticking(log, eventually, launch)
    said = interrupted(launch)
    assert "no argument 'publish_lnk_tf'; did you mean publish_link_tf?" in said
    assert "robot_name" not in said
    assert "[spot.unicon]: running recorded" in said


def test_prefixes_of_launch_are_kept(
    theirs: Clients,
    robot: tuple[Path, Path],
    started: Callable[..., Any],
    eventually: Callable[..., Any],
    domain: int,
) -> None:
    path, log = robot
    words = ("--launch-prefix", "env UNICON_X=1 sh -c '\"$@\"; true' sh")
    launch = started(theirs, "launch", *words, *LAUNCH[1:], f"workflow:={path}")
    ticking(log, eventually, launch)
    launch.kill()
    eventually(lambda: events(log, "close"), launch.said)
    eventually(lambda: not nodes_of(domain), launch.said)
