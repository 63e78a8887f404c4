"""`unicon bench simulators` times each simulator that is installed, and says which is not."""

from __future__ import annotations

import json

import pytest

from benchmarks.programs import TICKS, run_simulators


def test_a_tick_is_its_engine_and_little_beyond() -> None:
    pytest.importorskip("pybullet", reason="pip install 'unicon_ros[sim-pybullet]'")
    result = json.loads(run_simulators(rounds=1).to_json())
    cases = result["cases"]
    engine, beyond, tick = (cases[f"pybullet: {of}"] for of in ("engine", "beyond", "tick"))
    assert engine["samples"] == TICKS
    assert 0.0 < beyond["p50"] < engine["p50"] < tick["p50"]
    assert 1.0 < result["ratios"]["pybullet"]["value"] < 2.0
    assert result["facts"]["pybullet: physics steps in a tick"] == 40
