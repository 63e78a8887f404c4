"""Options of a run in Python: wrong ones are one clear error, before anything runs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from unicon_base.errors import UniconError
from unicon_core.flow import Block, Stage
from unicon_core.run_program import run
from unicon_core.runtime import Runner, RunOptions
from unicon_core.runtime.phases import never_ends
from unicon_core.workflow import Program
from unicon_core.workflow.uses import block
from unicon_ros.cli.main import main


@pytest.mark.parametrize(
    ("options", "wrong"),
    [
        ({"speed": "fast"}, "speed is 'fast'; give 'real' or 'max'"),
        ({"speed": None}, "speed is None; give 'real' or 'max'"),
        ({"duration": "2"}, "duration is '2'; give seconds, as a number of at least 0"),
        ({"duration": math.nan}, "duration is nan; give seconds, as a number of at least 0"),
        ({"duration": math.inf}, "duration is inf; give seconds, as a number of at least 0"),
        ({"duration": -1.0}, "duration is -1.0; give seconds, as a number of at least 0"),
        ({"sped": "max"}, "unknown option 'sped' of run; did you mean 'speed'? known: capacity,"),
    ],
)
def test_a_wrong_option_is_named_before_anything_runs(options: dict[str, Any], wrong: str) -> None:
    ticks: list[int] = []
    closed: list[int] = []
    count = Block("count", lambda: ticks.append(1), close=lambda: closed.append(1))
    program = Program(
        robot="go2",
        platform="fake",
        rate=50,
        flow=block("hold"),
        hooks=[lambda program: {Stage.RECV: [count]}],
    )
    with pytest.raises(UniconError) as raised:
        run(program, **options)
    assert str(raised.value).startswith(wrong)
    assert not ticks
    assert closed


@pytest.mark.parametrize("duration", [0, 2, 0.5, np.float32(0.5), np.int64(1), None])
def test_a_duration_is_any_number_of_seconds(duration: Any) -> None:
    assert RunOptions(duration=duration).duration == duration


@pytest.mark.parametrize(
    ("described", "duration", "endless"),
    [
        ({}, None, True),
        ({}, 2.0, False),
        ({"duration": 2.0}, None, False),
        ({"flow": block("hold", duration=2.0)}, None, False),
        ({"platform": "fake"}, None, False),  # whose `recv` may end a run
    ],
)
def test_it_is_known_of_a_run_that_it_never_ends_by_itself(
    described: dict[str, Any], duration: float | None, endless: bool
) -> None:
    pytest.importorskip("mujoco")
    walks = block("velocity_command", schedule=[[0.0, 0.5, 0.0, 0.0]])
    said = {"platform": "mujoco", "flow": block("hold"), "commands": [walks]} | described
    program = Program(robot="go2", rate=50, **said)
    assert never_ends(program, RunOptions(duration=duration)) is endless
    program.close()


def test_the_command_line_says_so_at_its_start(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("mujoco")
    words = ["run", "h1_stand", "--set", "robot=go2", "--no-ros", "--quiet", "--speed"]

    def stopped(*_: Any) -> None:
        raise UniconError("stopped")

    monkeypatch.setattr(Runner, "run", stopped)
    told = []
    for more in (["max"], ["real"], ["max", "--duration", "1"]):
        assert main([*words, *more]) == 1
        told.append("h1_stand never ends by itself: Ctrl-C does" in capfd.readouterr().err)
    assert told == [True, False, False]
