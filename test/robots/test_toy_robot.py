"""A robot of one's own needs neither sources nor what it does not have: fifteen lines run."""

from __future__ import annotations

from pathlib import Path

import pytest

from unicon_base.errors import RobotError
from unicon_core.robots import load_robot
from unicon_ros.cli.main import main

TOY = """\
schema: unicon.robot/1
name: toy
kind: arm
models: {mjcf: toy.xml}
base_frame: base
joints:
  - {name: lift, lower: -1, upper: 1, velocity: 5, effort: 9, default: 0, stiffness: 20, damping: 1}
  - {name: turn, lower: -2, upper: 2, velocity: 5, effort: 9, default: 0, stiffness: 20, damping: 1}
"""
MODEL = """\
<mujoco><worldbody><body name="base"><geom size="0.1" mass="1"/>
  <body name="a" pos="0 0 0.2"><joint name="lift" axis="0 1 0"/><geom size="0.05" mass="0.5"/>
    <body name="b" pos="0.2 0 0"><joint name="turn" axis="0 0 1"/><geom size="0.05" mass="0.2"/>
    </body></body></body></worldbody>
  <actuator><motor joint="lift"/><motor joint="turn"/></actuator></mujoco>
"""


@pytest.fixture
def toy(tmp_path: Path) -> Path:
    (tmp_path / "toy.xml").write_text(MODEL)
    (tmp_path / "toy.yaml").write_text(TOY)
    (tmp_path / "hold.yaml").write_text(
        "robot: ./toy.yaml\nplatform: mujoco\nrate: 50\nduration: 0.5\nflow: hold\n"
    )
    return tmp_path


def test_a_toy_of_two_joints_is_checked_and_runs(
    toy: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert len(TOY.splitlines()) <= 15
    robot = load_robot(toy / "toy.yaml")
    assert (robot.num_joints, robot.manufacturer, robot.unknown) == (2, "", ())
    assert main(["robots", str(toy / "toy.yaml")]) == 0
    assert main(["check", str(toy / "hold.yaml")]) == 0, capsys.readouterr().out
    assert main(["run", str(toy / "hold.yaml"), "--no-ros", "--speed", "max", "--quiet"]) == 0


def test_a_vendors_robot_says_where_its_facts_are_from(toy: Path) -> None:
    (toy / "toy.yaml").write_text(f"{TOY}manufacturer: Toys\n")
    with pytest.raises(RobotError) as caught:
        load_robot(toy / "toy.yaml")
    said = [each.message for each in caught.value.problems]
    assert any("missing key 'sources'" in text for text in said)
    assert any("missing key 'transport'" in text for text in said)
    assert any("missing key 'rest'" in text for text in said)


def test_what_a_toy_lacks_is_lacking_for_a_real_robot(toy: Path) -> None:
    assert "transport.protocol" in load_robot(toy / "toy.yaml").missing_facts()
