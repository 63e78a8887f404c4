"""Other people's policies walk in our workflows, from their own metadata and the facts given."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from unicon_core.runtime import Report, Runner, RunOptions
from unicon_core.workflow import load_workflow

pytest.importorskip("mujoco", reason="the walks need mujoco")
pytest.importorskip("onnxruntime", reason="the policies need onnxruntime")


def run(name: str, overrides: Sequence[str] = (), seconds: float = 10.0) -> Report:
    workflow = load_workflow(name, overrides)
    return Runner(workflow, RunOptions(duration=seconds, speed="max")).run()


@pytest.mark.parametrize(
    ("name", "least"), [("g1_walk", 4.0), ("go1_walk", 8.0), ("g1_holosoma", 2.0)]
)
def test_a_foreign_policy_walks_ten_seconds(name: str, least: float, assets: Path) -> None:
    report = run(name)
    assert not report.faults
    assert not report.fell
    assert report.duration_s == pytest.approx(10.0)
    assert report.base_displacement_m[0] > least


def test_go1_stands_in_its_default_pose_on_the_model_with_position_actuators(assets: Path) -> None:
    report = run("go1_walk", ["flow={hold: {duration: 3.0}}", "rate=50"], 2.5)
    assert not report.faults
    assert not report.fell
    assert abs(report.base_displacement_m[2]) < 0.05


def test_a_workflow_runs_on_another_platform_by_one_word(assets: Path) -> None:
    report = run("g1_walk", ["platform=fake"], 1.0)
    assert report.platform == "fake"
    assert not report.faults
