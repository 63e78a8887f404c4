"""`unicon bench latency --budget`: a tick's time by who takes it, measured in a real process."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from unicon_ros.bench.loops import Slice
from unicon_ros.bench.pipelines.budget import add
from unicon_ros.bench.report import Bench
from unicon_ros.cli.main import main


def test_rows_say_who_takes_the_time_and_when() -> None:
    ticks = 20
    names = ["stamp", "begin", "collected", "collections", "warmed", "warm_ups", "cold", "warm"]
    names += ["faults", "switches"]
    row = [10_000, 210_000, 4_000, 1, 90_000, 3, 50_000, 20_000, 0, 2]
    rows = np.tile(row, (ticks, 1))
    rows[:2] = 10**12  # behind the slice
    log = {
        "columns": np.array(names),
        "rows": rows,
        "labels": np.array(["recv", "never", "send", "record"]),
        "spans": np.tile([30.0, 0.0, 50.0, 15.0], (ticks + 3, 1)),  # more than have a state
        "deferred": np.array([False, False, False, True]),
    }
    bench = Bench("made", 1)
    add(bench, log, Slice(0, 10**9, 0.1, 0.1))
    told = {name: case["mean"] for name, case in bench.cases.items()}
    assert told == {
        "before: state made, under way, thread awake, received": 200.0,
        "to command: recv": 30.0,
        "to command: send": 50.0,
        "to command: sum": 80.0,
        "after it: record": 15.0,
        "after it: sum": 15.0,
        "between: warm-ups, all": 90.0,
        "between: warm-up, the first, cold": 50.0,
        "between: warm-up, the last": 20.0,
        "between: garbage collection": 4.0,
    }
    assert bench.cases["to command: recv"]["samples"] == 18
    assert bench.facts["involuntary switches of the thread, a tick"] == "mean 2, at most 2"


@pytest.mark.slow
@pytest.mark.ros
@pytest.mark.alone
def test_the_budget_of_a_recorded_run(tmp_path: Path) -> None:
    pytest.importorskip("rclpy")
    file = tmp_path / "bench.json"
    assert main(["bench", "latency", "--budget", "--seconds", "3", "--json", str(file)]) == 0
    result = json.loads(file.read_text())
    cases = {name: case["p50"] for name, case in result["cases"].items()}
    assert cases["between: warm-up, the last"] < cases["between: warm-up, the first, cold"]
    for when in ("to command", "after it"):
        parts = sum(each for name, each in cases.items() if name.startswith(f"{when}: "))
        assert 0.8 < (parts - cases[f"{when}: sum"]) / cases[f"{when}: sum"] < 1.2
    assert any("record" in name for name in cases if name.startswith("after it"))
    assert cases["before: state made, under way, thread awake, received"] > 10.0
