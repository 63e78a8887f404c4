"""The paper's A1 case: recordings of a Go2 with a weak calf, and what the analysis says of them."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from unicon_lab.analysis.comparison import Comparison, compare_runs
from unicon_lab.analysis.paired_runs import bring_together
from unicon_lab.analysis.run import read_run
from unicon_ros.cli.main import main

pytest.importorskip("mujoco")
pytest.importorskip("onnxruntime")

WORKFLOW = str(Path(__file__).resolve().parents[2] / "examples" / "weak_calf.yaml")
STRENGTH = 0.3  # of the example


def recorded(path: Path, seed: int, *more: str) -> Path:
    run = ["run", WORKFLOW, "--speed", "max", "--quiet", "--no-ros", "--record", str(path)]
    assert main([*run, "--set", f"scene.seed={seed}", *more]) in (0, 3)
    return path


def compared(real: Path, sim: Path) -> Comparison:
    return compare_runs(bring_together(read_run(real), read_run(sim)))


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_weak_calf_is_first_in_twenty_of_twenty(tmp_path: Path) -> None:
    sim = recorded(tmp_path / "sim.mcap", 1000, "--set", "scene.joints={}")
    fell = 0
    for seed in range(20):
        found = compared(recorded(tmp_path / f"{seed}.mcap", seed), sim)
        first, second = found.order[:2]
        assert found.together.joints[first] == "RL_calf_joint", seed
        assert found.joints["gap"][first] > 2.0 * found.joints["gap"][second], seed
        assert found.joints["strength"][first] == pytest.approx(STRENGTH, rel=0.1), seed
        assert float(abs(found.joints["strength"] - 1.0)[found.order[1:]].max()) < 0.25, seed
        fell += not math.isnan(found.together.falls[0])
    assert fell >= 18
    sound = compared(recorded(tmp_path / "sound.mcap", 7, "--set", "scene.joints={}"), sim)
    assert float(sound.joints["gap"].max()) < 0.05
    assert math.isnan(sound.together.falls[0])
