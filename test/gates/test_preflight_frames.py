"""Preflight counts a robot's frames, where its driver speaks the robot's own protocol."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import pytest

from unicon_core.platforms.fake import FakeRobot
from unicon_core.platforms.kit.scene import Scene
from unicon_core.preflight.look import PreflightResult, tell_frames
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.workflow import load_workflow


class Framed(FakeRobot):
    """Tells at a rate, which is the machine's clock alone: a busy one changes nothing."""

    facts = replace(FakeRobot.facts, name="framed", protocols=("unitree_go",))
    hz = 500.0

    def arrivals(self) -> int:
        return int(time.perf_counter() * self.hz)


class Foreign(Framed):
    """One over topics, which has another rate than the robot."""

    facts = replace(Framed.facts, protocols=())


def make(
    states: States, robot: Robot, period: float, *, foreign: bool = False, silent: bool = False
) -> Framed:
    return (Foreign if foreign else Framed)(states, robot, period, Scene(), 0.0)


@pytest.mark.parametrize(
    ("hz", "foreign", "ok", "words"),
    [
        (500.0, False, True, " frames a second, 500 are promised"),
        (50.0, False, False, "see whether the robot is in another mode"),
        (50.0, True, None, ""),
    ],
)
def test_frames_are_as_many_as_the_robot_file_promises(
    monkeypatch: pytest.MonkeyPatch, hz: float, foreign: bool, ok: Any, words: str
) -> None:
    monkeypatch.setattr(Framed, "hz", hz)
    name = "test_preflight_frames:make"
    options = {name: {"foreign": foreign}}
    program = load_workflow("go2_stand", {"platform": name, "platforms": options})
    result = PreflightResult("tried", "go2", "framed")
    try:
        tell_frames(program, result)
    finally:
        program.close()
    told = result.to_dict()["rows"]
    if ok is None:
        assert told == []
        return
    (row,) = told
    assert (row["name"], row["ok"]) == ("frames", ok)
    assert words in row["told"]
    assert ("go2.yaml" in row["told"]) is not ok
