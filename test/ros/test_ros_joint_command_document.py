"""docs/howto/ros2_control.md: its maps build, its workflows pass the check, its names exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

from unicon_base.resources import list_config
from unicon_core.robots import load_robot
from unicon_msgs_map import parse_map
from unicon_ros.cli.main import main

pytestmark = [pytest.mark.ros, pytest.mark.timeout(60)]

TEXT = (Path(__file__).resolve().parents[2] / "docs" / "howto" / "ros2_control.md").read_text(
    "utf-8"
)
BLOCKS = re.findall(r"^```yaml\n# (\w+)\n(.*?)^```", TEXT, re.M | re.S)


def test_every_block_says_what_it_is() -> None:
    assert [title for title, _ in BLOCKS] == ["workflow", "map", "workflow", "controllers"]


@pytest.mark.parametrize("text", [text for title, text in BLOCKS if title == "workflow"])
def test_its_workflows_are_clean(text: str, tmp_path: Path) -> None:
    path = tmp_path / "documented.yaml"
    path.write_text(text)
    assert main(["check", str(path)]) == 0


def test_its_map_has_a_trajectory() -> None:
    (text,) = [text for title, text in BLOCKS if title == "map"]
    mapping = parse_map(text)
    assert mapping.trajectory is not None
    assert (mapping.trajectory.missing, mapping.trajectory.goal_time) == ("hold", 1.0)
    assert not mapping.subscribe


def test_the_controllers_joints_are_the_robots_in_its_order() -> None:
    (text,) = [text for title, text in BLOCKS if title == "controllers"]
    said = yaml.safe_load(text)["forward_position_controller"]["ros__parameters"]["joints"]
    assert tuple(said) == load_robot("go2").joint_names


def test_the_workflows_and_maps_that_it_names_are_there() -> None:
    table = TEXT.partition("| who commands")[2].partition("\n\n")[0]
    named = set(re.findall(r"`(\w+)`", table))
    known = {*list_config("maps"), *list_config("workflows")}
    types = {"JointState", "Float64MultiArray", "JointTrajectory", "FollowJointTrajectory"}
    assert named - types <= known
