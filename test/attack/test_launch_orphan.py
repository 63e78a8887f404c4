"""Launch never leaves a controller behind: all is decided before, and the node ends with it."""

from __future__ import annotations

import importlib.util
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from robot_host import HERE, ROOT, wait_for, write_workflow

LAUNCH_FILE = ROOT / "launch" / "unicon.launch.py"
IMPORTS = {
    "launch": ("LaunchContext", "LaunchDescription"),
    "launch.actions": ("DeclareLaunchArgument", "LogInfo", "OpaqueFunction"),
    "launch.substitutions": ("LaunchConfiguration",),
    "launch_ros": (),
    "launch_ros.actions": ("Node",),
    "launch_ros.parameter_descriptions": ("ParameterValue",),
}


@pytest.fixture
def launch_file(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The launch file with stand-ins for ROS's launch: `nodes` takes a mapping of arguments."""
    for name, attributes in IMPORTS.items():
        module = ModuleType(name)
        for attribute in attributes:
            setattr(module, attribute, lambda *_, **options: SimpleNamespace(**options))
        monkeypatch.setitem(sys.modules, name, module)

    def configuration(name: str) -> Any:
        return SimpleNamespace(perform=lambda context: context.launch_configurations[name])

    sys.modules["launch.substitutions"].LaunchConfiguration = configuration  # type: ignore[attr-defined]
    spec = importlib.util.spec_from_file_location("unicon_launch", LAUNCH_FILE)
    assert spec is not None
    assert spec.loader is not None
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded


def prefix(folder: Path, *programs: str) -> Path:
    """Make an install prefix with executables PACKAGE/NAME that say that they were started."""
    for program in programs:
        path = folder / "lib" / program
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"#!/bin/sh\ntouch {folder}/started_{path.name}\nsleep 20\n")
        path.chmod(0o755)
        index = folder / "share" / "ament_index" / "resource_index" / "packages"
        index.mkdir(parents=True, exist_ok=True)
        (index / path.parent.name).touch()
    return folder


def started(launch_file: ModuleType, *given: str, **arguments: str) -> list[Any]:
    """What is started with arguments; `given` is the command line of `ros2 launch`."""
    defaults = {name: default for name, (default, _) in launch_file.ARGUMENTS.items()}
    context = SimpleNamespace(launch_configurations=defaults | arguments, argv=list(given))
    made: list[Any] = launch_file.nodes(context)
    return made


def decided(launch_file: ModuleType, **arguments: str) -> list[str]:
    return [node.executable for node in started(launch_file, **arguments)]


def test_without_rviz2_nothing_is_started_and_the_remedy_named(
    launch_file: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(prefix(tmp_path, "unicon_ros/unicon_node")))
    monkeypatch.setenv("ROS_DISTRO", "jazzy")
    assert decided(launch_file) == ["unicon_node"]
    with pytest.raises(RuntimeError) as error:
        decided(launch_file, rviz="true")
    assert str(error.value) == (
        "no executable 'rviz2' of package 'rviz2' in AMENT_PREFIX_PATH; install it "
        "(sudo apt install ros-jazzy-rviz2), or leave rviz:=true out"
    )


def test_with_rviz2_both_are_started(
    launch_file: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = prefix(tmp_path / "other", "rviz2/rviz2")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path}{os.pathsep}{other}")
    assert decided(launch_file, rviz="true") == ["unicon_node", "rviz2"]


def test_the_node_is_told_to_end_with_the_launch(launch_file: ModuleType) -> None:
    assert started(launch_file)[0].arguments == ["--end-with", str(os.getpid())]
    (alone,) = started(launch_file, end_with_launch="false")
    assert alone.arguments == ["--end-with", "nobody"]


def test_there_is_an_argument_for_each_parameter_of_its_type(launch_file: ModuleType) -> None:
    from unicon_ros.parameter_table import DECLARED

    launch_file.ParameterValue = lambda value, value_type: value_type(value)
    words = {bool: "false", int: "90", float: "0.5", str: "some", list: "['a=1', 'b=2']"}
    given = {name: words[type(default)] for name, default, _ in DECLARED}
    (node,) = started(launch_file, **given, use_sim_time="true")
    (parameters,) = node.parameters
    values = {bool: False, int: 90, float: 0.5, str: "some", list: ["a=1", "b=2"]}
    assert parameters == {name: values[type(d)] for name, d, _ in DECLARED} | {"use_sim_time": True}
    (node,) = started(launch_file, overrides="[]")
    assert node.parameters[0]["overrides"] == [""]


def test_what_is_not_given_is_left_to_the_file_and_the_node(
    launch_file: ModuleType, tmp_path: Path
) -> None:
    launch_file.ParameterValue = lambda value, value_type: value_type(value)
    file = tmp_path / "parameters.yaml"
    file.write_text("/**:\n  ros__parameters: {rate: 20}\n")
    (node,) = started(launch_file)
    assert node.parameters == [{"workflow": "go2_stand"}]
    (node,) = started(launch_file, params_file=str(file), rate="5", name="walker")
    assert node.parameters == [str(file), {"rate": 5.0}]
    assert node.name == "walker"


@pytest.mark.parametrize(
    ("section", "found"),
    [
        ("/**", True),
        ("/robot1/unicon", True),
        ("robot1/unicon", True),
        ("/*/unicon", True),
        ("/**/unicon", True),
        ("/robot1: {unicon", True),
        ("unicon", False),
        ("/*", False),
        ("/robot2/unicon", False),
    ],
)
def test_a_parameter_file_says_something_for_the_node(
    launch_file: ModuleType, tmp_path: Path, section: str, found: bool
) -> None:
    file = tmp_path / "parameters.yaml"
    end = "}" if "{" in section else ""
    file.write_text(f"{{{section}: {{ros__parameters: {{rate: 20}}}}{end}}}")
    if found:
        assert started(launch_file, params_file=str(file), namespace="/robot1/")
        return
    with pytest.raises(ValueError, match=r"no parameters for node /robot1/unicon, but for /"):
        started(launch_file, params_file=str(file), namespace="/robot1/")


@pytest.mark.parametrize(
    ("content", "said"),
    [(None, "No such file"), ("{a: [", "not YAML"), ("[]", "but for none"), ("", "but for none")],
)
def test_a_wrong_parameter_file_is_one_error(
    launch_file: ModuleType, tmp_path: Path, content: str | None, said: str
) -> None:
    file = tmp_path / "parameters.yaml"
    if content is not None:
        file.write_text(content)
    with pytest.raises(ValueError, match=said) as error:
        started(launch_file, params_file=str(file))
    assert str(error.value).startswith(f"argument params_file:={file}: ")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("by", ["unicon_ros", "path"])
def test_an_unknown_argument_of_the_command_line_is_refused(
    launch_file: ModuleType, monkeypatch: pytest.MonkeyPatch, by: str
) -> None:
    words = ["unicon_ros", LAUNCH_FILE.name] if by == "unicon_ros" else [str(LAUNCH_FILE)]
    monkeypatch.setattr(sys, "argv", ["ros2", "launch", *words, "workflw:=x"])
    with pytest.raises(
        ValueError, match="no argument 'workflw'; did you mean workflow\\? known: a"
    ):
        started(launch_file, "workflw:=x", workflw="x")
    allowed = started(launch_file, "rate:=5", "launch-prefix:=gdb", rate="5")
    assert [node.executable for node in allowed] == ["unicon_node"]


def test_an_including_launch_file_has_arguments_of_its_own(
    launch_file: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["ros2", "launch", "mine", LAUNCH_FILE.name, "colour:=red"])
    told, node = started(launch_file, "colour:=red", colour="red", publish_lnk_tf="false")
    assert "did you mean publish_link_tf?" in told.msg
    assert node.executable == "unicon_node"


def test_launch_itself_starts_nothing_without_rviz2(tmp_path: Path) -> None:
    pytest.importorskip("launch_ros.actions", reason="no launch_ros: source a ROS 2 installation")
    code = (
        "import sys, launch\n"
        "from launch.actions import IncludeLaunchDescription as Include\n"
        "from launch.launch_description_sources import PythonLaunchDescriptionSource as Source\n"
        "service = launch.LaunchService()\n"
        "included = Include(Source(sys.argv[1]), launch_arguments=[('rviz', 'true')])\n"
        "service.include_launch_description(launch.LaunchDescription([included]))\n"
        "sys.exit(service.run())\n"
    )
    environment = dict(os.environ)
    environment["AMENT_PREFIX_PATH"] = str(prefix(tmp_path, "unicon_ros/unicon_node"))
    done = subprocess.run(
        [sys.executable, "-c", code, str(LAUNCH_FILE)],
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 1
    assert "sudo apt install" in done.stdout + done.stderr
    assert not (tmp_path / "started_unicon_node").exists()


PARENT = """\
import os, subprocess, sys
code = "import sys; from unicon_ros.node_main import main; sys.exit(main(sys.argv[1:]))"
workflow, whom = sys.argv[-2:]
between = ["sh", "-c", '"$@"; true', "sh"] if whom == "through" else []
given = {"own": os.getpid(), "through": os.getpid()}.get(whom, whom)
options = [] if whom == "unsaid" else ["--end-with", str(given)]
arguments = [*options, "--ros-args", "-p", f"workflow:={workflow}"]
subprocess.Popen([*between, sys.executable, "-c", code, *arguments]).wait()
"""


@pytest.fixture
def parent(tmp_path: Path) -> Iterator[Any]:
    started: list[subprocess.Popen[str]] = []

    def start(path: Path, whom: str) -> subprocess.Popen[str]:
        environment = dict(os.environ)
        environment["PYTHONPATH"] = os.pathsep.join((str(HERE), str(ROOT)))
        script = tmp_path / "ros2"  # started as `python3 …/ros2 launch …`
        script.write_text(PARENT)
        command = [sys.executable, str(script), "launch", str(path), whom]
        pipe = subprocess.PIPE
        started.append(
            subprocess.Popen(command, env=environment, stderr=pipe, stdout=pipe, text=True)
        )
        return started[-1]

    yield start
    for each in started:
        each.kill()


@pytest.mark.ros
@pytest.mark.timeout(90)
@pytest.mark.skipif(sys.platform != "linux", reason="prctl is Linux's")
@pytest.mark.parametrize("whom", ["own", "parent", "unsaid", "through"])
def test_a_node_whose_launch_is_killed_damps_and_ends(
    tmp_path: Path, parent: Any, whom: str
) -> None:
    pytest.importorskip("rclpy")
    from estop_platform import events

    path, log = write_workflow(tmp_path)
    started = parent(path, whom)
    wait_for(lambda: len(events(log, "send")) > 10, "commands")
    started.kill()
    _, errors = started.communicate(timeout=20)  # ends when the node has let the pipe go
    assert "ended after" in errors
    assert len(events(log, "close")) == 1


@pytest.mark.ros
@pytest.mark.timeout(90)
@pytest.mark.skipif(sys.platform != "linux", reason="prctl is Linux's")
def test_a_node_that_ends_with_nobody_outlives_its_launch(tmp_path: Path, parent: Any) -> None:
    pytest.importorskip("rclpy")
    from estop_platform import events

    path, log = write_workflow(tmp_path)
    started = parent(path, "nobody")
    wait_for(lambda: len(events(log, "send")) > 10, "commands")
    (node,) = children(started.pid)
    started.kill()
    started.wait()
    sent = len(events(log, "send"))
    try:
        wait_for(lambda: len(events(log, "send")) > sent + 20, "commands")
    finally:
        os.kill(node, signal.SIGTERM)
    started.communicate(timeout=20)
    assert len(events(log, "close")) == 1


def children(process: int) -> list[int]:
    found = Path(f"/proc/{process}/task/{process}/children").read_text().split()
    return [int(number) for number in found]


@pytest.mark.ros
def test_whom_to_end_with_is_a_process_a_parent_or_nobody(
    capsys: pytest.CaptureFixture[str],
) -> None:
    pytest.importorskip("rclpy")
    from unicon_ros.node_main import main

    assert main(["--end-with", "mother"]) == 1
    said = "--end-with mother: give the id of the process that started this, parent or nobody"
    assert said in capsys.readouterr().err


@pytest.mark.ros
@pytest.mark.skipif(sys.platform != "linux", reason="prctl is Linux's")
def test_a_node_whose_parent_is_another_one_does_not_start(
    capsys: pytest.CaptureFixture[str],
) -> None:
    pytest.importorskip("rclpy")
    from unicon_ros.node_main import main

    assert main(["--end-with", "1"]) == 1
    assert "--end-with 1: that process has ended, or is not the one" in capsys.readouterr().err
