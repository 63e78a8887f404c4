"""`unicon bench view` compares a run with and without somebody who looks."""

from __future__ import annotations

import json

import pytest

pytest.importorskip("viser", reason="pip install 'unicon_ros[view]'")
pytest.importorskip("mujoco")
pytest.importorskip("onnxruntime")

from benchmarks.runs import run_view

pytestmark = pytest.mark.slow


def test_all_turns_run_and_two_clients_are_served() -> None:
    result = json.loads(run_view(rounds=1, seconds=3.0).to_json())
    assert len(result["cases"]) == 2 * 3
    assert all(case["samples"] == 1000 for case in result["cases"].values())
    assert set(result["ratios"]) == {"view_p50", "view_p99"}
    least, most = result["facts"]["messages a client got"].split(" to ")
    assert int(least) == 0  # the one that has stalled
    assert int(most.replace(",", "")) > 10
