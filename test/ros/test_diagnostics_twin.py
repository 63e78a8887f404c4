"""/diagnostics tells each joint's gap and lag to the live twin, and warns of those that differ."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="this one needs ROS")

from unicon_core.robots import load_robot
from unicon_core.runtime.phases import Phase
from unicon_core.states import States
from unicon_core.workflow.live_twin import twin_states
from unicon_ros.bridge.diagnostics import OK, WARN, Diagnostics, _twin


def test_gaps_lags_and_flags_are_told_by_joint() -> None:
    robot = load_robot("go2")
    states = States(twin_states(robot))
    runner: Any = SimpleNamespace(program=SimpleNamespace(states=states, robot=robot))
    values: dict[str, str] = {}
    assert _twin(runner, values) == []
    assert values["twin RL_calf_joint"] == "gap 0.000 rad, lag +0 ms"
    states["twin_gap"][11], states["twin_lag"][11], states["twin_flag"][11] = 0.31, 0.04, 1
    wrong = ["not as the twin: RL_calf_joint; worst RL_calf_joint, 0.31 rad"]
    assert _twin(runner, values) == wrong
    assert values["twin RL_calf_joint"] == "gap 0.310 rad, lag +40 ms"


def test_what_else_is_wrong_goes_before_the_twin() -> None:
    robot = load_robot("go2")
    statistics = SimpleNamespace(count=100, overruns=0, rows=np.empty((0, 4)), names=())
    program = SimpleNamespace(
        name="walk",
        platform=SimpleNamespace(facts=SimpleNamespace(name="fake")),
        states=States(twin_states(robot)),
        robot=robot,
    )
    diagnostics = Diagnostics(MagicMock(), SimpleNamespace(latched=False))  # type: ignore[arg-type]
    diagnostics.runner = SimpleNamespace(  # type: ignore[assignment]
        statistics=statistics, program=program, phase=Phase.RUN, paused_s=0.0, waits_for=""
    )
    assert diagnostics.status()[:2] == (OK, "running")
    size = "+4 kg (95 %: +3.9 kg to +4.1 kg)"  # as `unicon run --diagnose` tells it
    diagnostics.causes = {"cause payload": size}
    level, message, values = diagnostics.status()
    assert (level, message, values["cause payload"]) == (WARN, f"cause payload: {size}", size)
    diagnostics.causes = {}
    program.states["twin_flag"][3] = 1
    level, message, _ = diagnostics.status()
    assert level == WARN
    assert message.startswith(f"not as the twin: {robot.joint_names[3]}; worst ")
    statistics.overruns = 5
    level, message, _ = diagnostics.status()
    assert level == WARN
    assert message.startswith("5 overruns in ")
