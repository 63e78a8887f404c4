"""`unicon bench record` compares the same run with and without a recording."""

from __future__ import annotations

import json

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from benchmarks.runs import run_record

pytestmark = [pytest.mark.ros, pytest.mark.slow]


def test_both_sides_run_and_one_is_recorded() -> None:
    result = json.loads(run_record(rounds=1, seconds=2.0).to_json())
    assert len(result["cases"]) == 4
    assert all(case["samples"] == 500 for case in result["cases"].values())
    assert result["facts"]["dropped"] == 0
    assert set(result["ratios"]) == {"record_p99"}
