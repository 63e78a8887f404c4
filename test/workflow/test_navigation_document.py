"""docs/howto/navigation.md: its workflows are built, its parameter files lead to what we hear."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from unicon_base.resources import find_config
from unicon_core.robots import load_robot
from unicon_msgs_map import load_map
from unicon_ros.cli.main import main

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "docs" / "howto" / "navigation.md").read_text("utf-8")
BLOCKS = re.findall(r"```yaml\n# ([\w ]+)\n(.*?)```", TEXT, re.DOTALL)


def one(kind: str) -> Any:
    (text,) = (text for name, text in BLOCKS if name == kind)
    return yaml.safe_load(text)


@pytest.mark.parametrize("text", [text for kind, text in BLOCKS if kind == "workflow"])
def test_its_workflows_are_clean(
    text: str, tmp_path: Path, assets: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "page.yaml"
    path.write_text(text, "utf-8")
    assert main(["check", str(path)]) == 0, capsys.readouterr().out


def test_the_last_of_nav2s_nodes_commands_what_the_map_hears() -> None:
    nav2, mapping = one("Nav2"), load_map(find_config("maps", "navigation"))
    monitor = nav2["collision_monitor"]["ros__parameters"]
    assert monitor["cmd_vel_out_topic"] in [spec.topic for spec in mapping.subscribe]
    assert monitor["base_frame_id"] == load_robot("go2").base_frame
    smoother = nav2["velocity_smoother"]["ros__parameters"]
    assert smoother["odom_topic"] in [spec.topic for spec in mapping.publish]
    policy = ROOT / "config" / "policies" / "go2_velocity" / "policy.yaml"
    ranges = yaml.safe_load(policy.read_text("utf-8"))["command_ranges"]
    for key, low, high in zip(
        ("lin_vel_x", "lin_vel_y", "ang_vel_z"), smoother["min_velocity"], smoother["max_velocity"]
    ):
        assert ranges[key][0] <= low < 0.0 < high <= ranges[key][1]


def test_robot_localization_has_fifteen_words_for_each_source() -> None:
    parameters = one("robot_localization")["ekf_filter_node"]["ros__parameters"]
    mapping = load_map(find_config("maps", "navigation"))
    for source in ("odom0", "imu0"):
        assert len(parameters[f"{source}_config"]) == 15
        assert parameters[source] in [spec.topic for spec in mapping.publish]
