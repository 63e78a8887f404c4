"""Figures of a transfer's runs are those of a sweep's rows: the same code, the same digits."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

from unicon_lab.sweep.worker import RowRunner
from unicon_lab.transfer.results import Results
from unicon_lab.transfer.rollout import FIGURES, KEPT, TimedRunner, make_plan

WALK = (
    *("flow={policy: walk}", "scene.initial_pose='policy:walk'", "scene.noise.joint_vel=0.2"),
    "commands=[{velocity_command: {constant: [0.8, 0.0, 0.2]}}]",
)


def test_a_simulator_that_is_not_installed_is_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "newton", None)
    plan = make_plan("go2_walk", WALK, "newton", 1, 1.2, 60.0)
    (row,) = plan.rows()
    told = TimedRunner(plan.task(), print)([*row.settings])["row"]
    assert told["outcome"] == "missing"
    assert "pip install 'unicon_ros[sim-newton]'" in told["text"]


@pytest.mark.parametrize("other", ["mujoco", "pybullet"])
def test_both_commands_have_the_same_figures(other: str, tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    pytest.importorskip(other)
    plan = make_plan("go2_walk", WALK, f"mujoco,{other}", 1, 1.2, 60.0)
    results, told = Results(plan, tmp_path), dict[str, dict[str, Any]]()
    words: list[dict[str, Any]] = []
    for row in plan.rows():
        task = plan.task() | {"keep": {"folder": str(tmp_path), "states": KEPT}}
        runner = TimedRunner(task, words.append)
        file = f"{row.values[0]}.npz"
        run = runner([*row.settings], row.values[0])["run"]
        runner.programs.close()
        run |= {"seed": 0, "outcome": "ran", "text": "", "file": file}
        results.add(row.values[0], run)
        told[row.values[0]] = run
    assert words[0] == {"at": pytest.approx(0.02)}
    reference = tmp_path / "mujoco.npz"
    swept = RowRunner(plan.task() | {"reference": str(reference)})
    row = swept([*plan.rows()[-1].settings])["row"]
    swept.programs.close()
    assert row["speed_error"] > 0.0
    assert row["energy_j"] > 0.0
    assert {name: row[name] for name in FIGURES} == {name: told[other][name] for name in FIGURES}
    if other == "pybullet":
        assert row["unfolded_mse"] == told[other]["compared"]["unfolded_mse"] > 1e-6
