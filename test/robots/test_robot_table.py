"""The tables of `unicon robots` are aligned, complete, and show what is unknown."""

from __future__ import annotations

from pathlib import Path

import pytest

from unicon_core.robots import load_robot, robot_table, robots_table


def test_overview_survives_a_broken_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "robots").mkdir()
    (tmp_path / "robots" / "broken.yaml").write_text("schema: [\n", encoding="utf-8")
    monkeypatch.setenv("UNICON_PATH", str(tmp_path))
    line = next(line for line in robots_table().splitlines() if line.startswith("broken: "))
    assert "the file is wrong" in line
    assert "broken.yaml:2: not valid YAML" in line


@pytest.mark.parametrize("name", ["g1_29dof", "x2", "inspire_rh56_left", "arx_x5", "go2"])
def test_table_shows_every_joint_in_order_with_its_figures(name: str) -> None:
    robot = load_robot(name)
    lines = robot_table(robot).splitlines()
    start = next(i for i, line in enumerate(lines) if line.lstrip().startswith("#"))
    rows = [line.split() for line in lines[start + 2 : start + 2 + robot.num_joints]]
    assert [row[0] for row in rows] == [str(i) for i in range(robot.num_joints)]
    assert tuple(row[1] for row in rows) == robot.joint_names
    assert all(len(row) == 10 for row in rows)
    figures = [cell for row in rows for cell in row[2:]]
    assert ("?" in figures) == any(fact.startswith("joints.") for fact in robot.unknown) or (
        robot.position_controlled
    )


def test_table_marks_what_is_unknown_and_forbids_driving() -> None:
    text = robot_table(load_robot("dex3_right"))
    assert "joint (order not public)" in text
    assert "UNKNOWN: joint_order" in text
    assert "CANNOT BE DRIVEN before these are given: joint_order" in text
    assert text.splitlines()[-1].endswith("dex3_right.yaml")


def test_table_of_a_complete_robot_says_so() -> None:
    text = robot_table(load_robot("g1_29dof"))
    assert text.splitlines()[-1] == "unknown: nothing"
    assert "protocol" in text
    assert "rt/lowcmd" in text
    assert "imu_in_pelvis, position [0.04525 0 -0.08339] m" in text


def test_table_lists_every_source() -> None:
    robot = load_robot("t1")
    flat = " ".join(robot_table(robot).split())
    for text in robot.sources.values():
        assert " ".join(text.split()) in flat
