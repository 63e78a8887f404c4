"""`unicon bench safety` compares the same tick with and without a robot's safety blocks."""

from __future__ import annotations

import json

from benchmarks.runs import WITH, WITHOUT, run_safety


def test_both_sides_tick_the_same_policy() -> None:
    result = json.loads(run_safety(rounds=1).to_json())
    assert list(result["cases"]) == [WITH, WITHOUT]
    assert {"finite", "command_stop", "imu_stop"} <= {*result["facts"]["blocks"].split(", ")}
    assert 0.5 < result["ratios"]["safety"]["value"] < 5.0
