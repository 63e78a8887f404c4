"""Which model file a robot, a workflow or a platform means."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from unicon_base.errors import ModelError
from unicon_core.models.find import Modelled, model_of, pick_model
from unicon_core.robots import load_robot

GO2 = Path(__file__).resolve().parents[2] / "config" / "models" / "go2" / "go2.xml"


class Simulator:
    def __init__(self, path: Path) -> None:
        self.model_path = path


def test_what_a_platform_simulates_goes_before_the_robots_own(tmp_path):
    robot = load_robot("go2")
    simulator = Simulator(tmp_path / "other.xml")
    assert isinstance(simulator, Modelled)
    assert model_of(simulator, robot) == simulator.model_path
    assert model_of(object(), robot) == GO2


def test_what_is_given_goes_before_the_robots_own(tmp_path):
    (tmp_path / "other.xml").write_text("<mujoco/>", "utf-8")
    robot = load_robot("go2")
    assert pick_model(robot, "other.xml", tmp_path) == tmp_path / "other.xml"
    with pytest.raises(ModelError, match=r"nowhere\.xml"):
        pick_model(robot, "nowhere.xml", tmp_path)


def test_a_robot_without_a_model_says_so():
    with pytest.raises(
        ModelError, match=r"\(mjcf or urdf\); put one beside .*atom\.yaml and add models: \{mjcf: F"
    ):
        pick_model(load_robot("atom"))


def test_an_mjcf_goes_before_a_urdf():
    other = replace(load_robot("go2"), models={"urdf": "nowhere.urdf", "mjcf": str(GO2)})
    assert pick_model(other) == GO2
