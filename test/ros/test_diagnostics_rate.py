"""/diagnostics tells the rate of the ticks also while a run is paused, or stepped by hand."""

from __future__ import annotations

import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest

pytest.importorskip("rclpy", reason="this one needs ROS")

from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import load_workflow
from unicon_ros.bridge.diagnostics import OK, Diagnostics

pytestmark = pytest.mark.usefixtures("time_passes")

WORKFLOW = """\
schema: unicon.workflow/1
robot: go2
platform: fake
rate: 50
flow: {hold: {}}
safety: [finite]
"""


def test_pauses_and_single_ticks_leave_the_rate_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "paused.yaml"
    path.write_text(WORKFLOW)
    runner = Runner(load_workflow(path), RunOptions(duration=2.0))
    node: Any = MagicMock()
    diagnostics = Diagnostics(node, SimpleNamespace(latched=False))  # type: ignore[arg-type]
    diagnostics.runner = runner
    rates: dict[str, float] = {}

    def told(when: str) -> None:
        level, _, values = diagnostics.status()
        assert level == OK
        rates[when] = float(values["rate_hz"])

    def pause() -> None:
        time.sleep(0.5)
        told("before and in a pause")
        time.sleep(1.0)
        told("in a pause")
        time.sleep(0.9)
        runner.tick(time.perf_counter_ns())
        told("a single tick in a pause")
        time.sleep(0.3)

    def later() -> None:
        if runner.statistics.count == 25:
            runner.call_soon(pause)
        elif runner.statistics.count == 75:
            told("after a pause")
        if runner.statistics.count < 75:
            runner.call_soon(later)

    def begin() -> None:
        diagnostics.status()
        later()

    runner.call_soon(begin)
    assert runner.run().ticks == 100
    assert rates.pop("in a pause") == 0.0
    assert len(rates) == 3
    assert rates == pytest.approx(dict.fromkeys(rates, 50.0), rel=0.1)
