"""Options of a run in Python: wrong ones are one clear error, before anything runs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from unicon_core.errors import UniconError
from unicon_core.flow import Block, Stage
from unicon_core.runtime import RunOptions, run
from unicon_core.workflow import Program
from unicon_core.workflow.uses import block


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
