"""MJX runs MuJoCo's workflows by one word, a whole batch in one compiled call."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from unicon_base.errors import MissingDependencyError, ModelError
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import load_workflow

# What these tests run against, the most that config/evidence.yaml may say by them.
EVIDENCE = "vendor"


def test_without_it_the_install_command_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "jax", None)
    with pytest.raises(MissingDependencyError) as error:
        load_workflow("go2_stand", ["platform=mjx"])
    assert str(error.value) == "platform 'mjx' needs mujoco-mjx: pip install 'unicon_ros[sim-mjx]'"


@pytest.mark.slow
@pytest.mark.timeout(600)
class TestInstalled:
    @pytest.fixture(autouse=True)
    def installed(self) -> None:
        pytest.importorskip("mujoco.mjx", reason="pip install 'unicon_ros[sim-mjx]'")

    def test_go2_walks(self) -> None:
        report = Runner(load_workflow("go2_walk", ["platform=mjx"]), RunOptions(speed="max")).run()
        assert report.faults == []
        assert report.ended == "done"
        assert not report.fell
        assert np.hypot(*report.base_displacement_m[:2]) >= 3.5

    def test_16_robots_walk_in_one_graph(self) -> None:
        told = ["num_robots=16", "scene.initial_pose=policy:walk", "flow={policy: walk}"]
        told.append("commands=[{velocity_command: {constant: [0.5, 0.0, 0.0]}}]")
        workflow = load_workflow("go2_walk", ["platform=mjx", "start=none", *told])
        runner = Runner(workflow, RunOptions(speed="max"))
        try:
            for _ in range(75):
                runner.tick(0)
            assert workflow.states.joint_pos.shape == (16, 12)
            assert workflow.states.base_pos_w[:, 0].min() > 0.2
            assert -workflow.states.projected_gravity[:, 2].max() > 0.9
        finally:
            runner.close()

    def test_g1_walks(self, assets: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("UNICON_ASSETS", str(assets))
        workflow = load_workflow("g1_walk", ["platform=mjx", "duration=10"])
        report = Runner(workflow, RunOptions(speed="max")).run()
        assert report.faults == []
        assert not report.fell
        assert np.hypot(*report.base_displacement_m[:2]) >= 3.5

    def test_a_model_that_it_cannot_simulate_is_named(self, tmp_path: Path) -> None:

        text = (Path(__file__).parents[2] / "config/models/go2/go2.xml").read_text()
        path = tmp_path / "sparse.xml"
        path.write_text(text.replace("<option ", '<option solver="PGS" '), encoding="utf-8")
        with pytest.raises(
            ModelError, match=r"^platform 'mjx' cannot simulate model .*sparse\.xml"
        ):
            load_workflow("go2_stand", ["platform=mjx", f"scene.model={path}"])
