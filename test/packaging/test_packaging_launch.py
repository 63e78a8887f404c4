"""The launch file starts what its arguments say; needs ROS's launch, which has no wheels."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from source_tree import ROOT

# launch_ros first: our own folder launch/ answers to `import launch` where ROS's is missing.
pytest.importorskip("launch_ros.actions", reason="no launch_ros: source a ROS 2 installation")
launch = pytest.importorskip("launch")


@pytest.fixture(scope="module")
def launch_file() -> ModuleType:
    spec = importlib.util.spec_from_file_location("unicon", ROOT / "launch" / "unicon.launch.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def started(launch_file: ModuleType, **arguments: str) -> list[Any]:
    context = launch.LaunchContext()
    defaults = {name: default for name, (default, _) in launch_file.ARGUMENTS.items()}
    context.launch_configurations.update({**defaults, **arguments})
    nodes: list[Any] = launch_file.nodes(context)
    return nodes


def test_every_argument_is_declared_with_a_default(launch_file: ModuleType) -> None:
    declared = launch_file.generate_launch_description().get_launch_arguments()
    assert {argument.name for argument in declared} == set(launch_file.ARGUMENTS)


def test_the_node_starts_alone_by_default(launch_file: ModuleType) -> None:
    assert [node.node_executable for node in started(launch_file)] == ["unicon_node"]


def test_rviz_starts_with_our_view(
    launch_file: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = tmp_path / "lib" / "rviz2" / "rviz2"
    program.parent.mkdir(parents=True)
    program.touch(0o755)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    assert [n.node_executable for n in started(launch_file, rviz="true")][1:] == ["rviz2"]
    assert launch_file.RVIZ_CONFIG.is_file()


def test_the_view_of_a_robot_with_a_frame_prefix_looks_for_its_frames(
    launch_file: ModuleType,
) -> None:
    assert launch_file.rviz_config("") == launch_file.RVIZ_CONFIG
    text = launch_file.rviz_config("robot1/").read_text()
    assert "Fixed Frame: robot1/odom" in text
    assert "Reference Frame: robot1/odom" in text
    assert "Target Frame: robot1/base_link" in text
    assert "TF Prefix: robot1\n" in text


def test_remaps_are_pairs(launch_file: ModuleType) -> None:
    assert launch_file.remaps("cmd_vel:=teleop/cmd_vel odom:=ground_truth") == [
        ("cmd_vel", "teleop/cmd_vel"),
        ("odom", "ground_truth"),
    ]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"rviz": "maybe"}, "argument rviz:=maybe: write true or false"),
        ({"remap": "cmd_vel"}, "argument remap: 'cmd_vel' is not of the form from:=to"),
    ],
)
def test_a_wrong_argument_is_named(
    launch_file: ModuleType, arguments: dict[str, str], message: str
) -> None:
    with pytest.raises(ValueError) as error:
        started(launch_file, **arguments)
    assert str(error.value) == message
