"""`unicon check` has the topics in its graph that `unicon run --ros` has: both say the same."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("rosbags", reason="maps are read with rosbags")

from unicon_ros.cli.main import main

MAP = """
subscribe:
  - topic: goal
    type: std_msgs/msg/Float64MultiArray
    fields: {data: goal}
"""
LATE = MAP.replace("{data: goal}", "{data: joint_pos_target}")
WORKFLOW = """
robot: go2
platform: fake
rate: 50
duration: 0.2
ros: ROS
map: MAP
states: {goal: {shape: [2]}}
flow: {loop: {do: hold, until: "UNTIL"}}
"""


def said(folder: Path, capsys: pytest.CaptureFixture[str], **values: str) -> tuple[int, str]:
    (folder / "map.yaml").write_text(MAP, encoding="utf-8")
    text = WORKFLOW
    given = {"ROS": "true", "MAP": str(folder / "map.yaml"), "UNTIL": "goal[0] > 1"} | values
    for word, value in given.items():
        text = text.replace(word, value)
    path = folder / "attack.yaml"
    path.write_text(text, encoding="utf-8")
    status = main(["check", str(path)])
    return status, " ".join(capsys.readouterr().out.split())


def test_a_state_that_only_a_topic_writes_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert said(tmp_path, capsys)[0] == 0


def test_without_ros_nothing_writes_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, out = said(tmp_path, capsys, ROS="false")
    assert status == 1
    assert "reads 'goal', which no block writes" in out


def test_a_map_whose_topics_write_what_the_flow_writes_later_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "late.yaml").write_text(LATE, encoding="utf-8")
    status, out = said(tmp_path, capsys, MAP=str(tmp_path / "late.yaml"), UNTIL="tick > 3")
    assert status == 1
    assert "'ros inputs' amends 'joint_pos_target' before 'hold' has written it" in out


@pytest.mark.ros
def test_the_run_says_the_same(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("rclpy")
    said(tmp_path, capsys)
    run = ["run", str(tmp_path / "attack.yaml"), "--speed", "max", "--quiet"]
    assert main(run) == 0
    (tmp_path / "late.yaml").write_text(LATE, encoding="utf-8")
    assert main([*run, "--map", str(tmp_path / "late.yaml")]) == 1
    assert "'ros inputs' amends 'joint_pos_target'" in capsys.readouterr().err
