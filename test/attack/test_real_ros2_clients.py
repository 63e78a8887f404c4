"""unicon_node under ROS's own `ros2 launch`, `param`, `lifecycle`, `service`, from their sources.

Needs UNICON_ROS2_SOURCE, see ros2_from_source.py. Without it calls that equal theirs are tested, in
test_launch_orphan.py, test_latches_outlive_processes.py and test_ros_parameters.py, and by
peers/caller.py.
"""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")

from estop_platform import events
from robot_host import HERE, wait_for, write_workflow
from ros2_from_source import Lacking, Ros2

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


@pytest.fixture(scope="module")
def ros2(tmp_path_factory: pytest.TempPathFactory) -> Ros2:
    try:
        return Ros2(tmp_path_factory.mktemp("ros2"))
    except Lacking as lacking:
        pytest.skip(f"ROS's own clients are not tested: {lacking}")


Start = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def start(ros2: Ros2, domain: None) -> Iterator[Start]:
    """Starts `ros2 WORDS…`, and ends it with all that it has started."""
    started: list[subprocess.Popen[str]] = []

    def make(*words: str) -> subprocess.Popen[str]:
        started.append(ros2.start(*words, paths=(HERE,)))
        return started[-1]

    yield make
    for each in started:
        if each.poll() is None:
            each.send_signal(signal.SIGINT)
            try:
                each.communicate(timeout=20)
            except subprocess.TimeoutExpired:
                os.killpg(each.pid, signal.SIGKILL)


def ticking(log: Path, more: int = 20) -> None:
    before = len(events(log, "send"))
    wait_for(lambda: len(events(log, "send")) > before + more, "commands", 60.0)


def still(log: Path) -> int:
    """Return how many commands have left, once none does any more."""
    time.sleep(1.0)
    sent = len(events(log, "send"))
    time.sleep(1.0)
    assert len(events(log, "send")) == sent
    return sent


def end(launch: subprocess.Popen[str]) -> str:
    launch.send_signal(signal.SIGINT)
    said, _ = launch.communicate(timeout=30)
    return said


def answer(ros2: Ros2, service: str) -> str:
    status, said = ros2.say("service", "call", service, "std_srvs/srv/Trigger")
    assert status == 0, said
    return said


def test_there_is_an_argument_for_each_parameter(ros2: Ros2, domain: None) -> None:
    status, said = ros2.say(*LAUNCH, "--show-args")
    assert status == 0, said
    for name in (*(name for name, *_ in DECLARED), "params_file", "name", "use_sim_time"):
        assert f"\n    '{name}':\n" in said


@pytest.mark.parametrize(
    ("argument", "said"),
    [
        ("workflw:=go2_stand", "no argument 'workflw'; did you mean workflow? known: "),
        ("colour:=red", "no argument 'colour'; known: autostart, "),
        ("rate:=fast", "argument rate:=fast: write a number"),
        ("autostart:=maybe", "argument autostart:=maybe: write true or false"),
        ("overrides:=rate=5", "argument overrides:=rate=5: write a list"),
        ("params_file:=/nowhere.yaml", "argument params_file:=/nowhere.yaml: "),
        ("name:=", "malformed launch argument 'name:='"),
        ("remap:=cmd_vel", "'cmd_vel' is not of the form from:=to"),
        ("rviz:=true", "leave rviz:=true out"),
    ],
)
def test_a_wrong_argument_starts_nothing(
    ros2: Ros2, domain: None, argument: str, said: str
) -> None:
    status, told = ros2.say(*LAUNCH, argument)
    assert status == 1
    assert said in told
    assert "process started" not in told


def test_parameters_come_from_arguments_then_the_file(
    ros2: Ros2, start: Start, tmp_path: Path
) -> None:
    path, log = write_workflow(tmp_path)
    file = tmp_path / "parameters.yaml"
    file.write_text(
        f"/**/walker:\n  ros__parameters: {{workflow: {path}, rate: 60, max_vx: 1, force: []}}\n"
    )
    given = ("name:=walker", "namespace:=robot1", "max_vx:=0.5", "overrides:=['rate=40']")
    launch = start(*LAUNCH, f"params_file:={file}", *given)
    ticking(log)
    node = ("/robot1/walker", "--no-daemon", "--spin-time", "2")

    def get(name: str) -> str:
        status, said = ros2.say("param", "get", node[0], name, *node[1:])
        assert status == 0, said
        return said.strip()

    assert get("rate") == "Double value is: 60.0"
    assert get("max_vx") == "Double value is: 0.5"
    assert get("overrides") == "String values are: ['rate=40']"

    def put(name: str, value: str) -> str:
        return ros2.say("param", "set", node[0], name, value, *node[1:])[1].strip()

    assert put("max_vx", "1") == "Set parameter successful"
    assert get("max_vx") == "Double value is: 1.0"
    assert put("overrides", "[]") == "Set parameter successful"
    assert "workflow: unknown workflow 'go2_stnd'; did you mean 'go2_stand'?" in put(
        "workflow", "go2_stnd"
    )
    status, said = ros2.say("lifecycle", "get", node[0], "--no-daemon", "--spin-time", "2")
    assert (status, said.split()[0]) == (0, "active")
    said = end(launch)
    assert "process has finished cleanly" in said


def test_a_parameter_file_that_says_nothing_for_the_node_is_refused(
    ros2: Ros2, domain: None, tmp_path: Path
) -> None:
    file = tmp_path / "parameters.yaml"
    file.write_text("unicon:\n  ros__parameters: {rate: 60}\n")
    status, said = ros2.say(*LAUNCH, f"params_file:={file}", "namespace:=robot1")
    assert status == 1
    assert "it has no parameters for node /robot1/unicon, but for /unicon; " in said


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_the_node_damps_and_ends_when_launch_dies(
    start: Start, tmp_path: Path, number: signal.Signals
) -> None:
    path, log = write_workflow(tmp_path)
    launch = start(*LAUNCH, f"workflow:={path}")
    ticking(log)
    launch.send_signal(number)
    wait_for(lambda: events(log, "close"), "the end of the node", 30.0)
    launch.communicate(timeout=30)  # ends when the node has let the pipe go


def test_no_respawn_gets_round_an_estop_and_a_fault(
    ros2: Ros2, start: Start, tmp_path: Path
) -> None:
    path, log = write_workflow(tmp_path)
    own = tmp_path / "own.launch.py"
    own.write_text(OWN.format(workflow=str(path)))
    launch = start("launch", str(own))
    ticking(log)
    assert "success=True" in answer(ros2, "/unicon/estop")
    wait_for(lambda: events(log, "close"), "the end of the first node")
    sent = still(log)
    assert "the emergency stop is latched" in answer(ros2, "/unicon/start")
    life = ("lifecycle", "set", "/unicon")
    options = ("--no-daemon", "--spin-time", "2")
    assert "Transitioning successful" in ros2.say(*life, "configure", *options)[1]
    assert "Transitioning failed" in ros2.say(*life, "activate", *options)[1]
    assert still(log) == sent
    assert "success=True" in answer(ros2, "/unicon/clear_estop")
    assert "success=True" in answer(ros2, "/unicon/start")
    ticking(log)
    # Launch is killed: the node ends with it, though the launch file says nothing of that.
    closed = len(events(log, "close"))
    launch.kill()
    wait_for(lambda: len(events(log, "close")) > closed, "the end of the node", 30.0)
    said, _ = launch.communicate(timeout=30)
    assert "process has died" in said
    assert "exit code 3" in said
    assert "not started by itself: " in said


def test_a_launch_file_that_includes_ours_keeps_its_own_arguments(
    start: Start, tmp_path: Path
) -> None:
    path, log = write_workflow(tmp_path)
    own = tmp_path / "including.launch.py"
    own.write_text(INCLUDING.format(workflow=str(path)))
    launch = start("launch", str(own), "robot_name:=rex")
    ticking(log)
    said = end(launch)
    assert "no argument 'publish_lnk_tf'; did you mean publish_link_tf?" in said
    assert "robot_name" not in said
    assert "[spot.unicon]: running recorded" in said


def test_prefixes_of_launch_are_kept(start: Start, tmp_path: Path) -> None:
    path, log = write_workflow(tmp_path)
    words: tuple[Any, ...] = ("--launch-prefix", "env UNICON_X=1 sh -c '\"$@\"; true' sh")
    launch = start("launch", *words, *LAUNCH[1:], f"workflow:={path}")
    ticking(log)
    launch.kill()
    wait_for(lambda: events(log, "close"), "the end of the node", 30.0)
    launch.communicate(timeout=30)
