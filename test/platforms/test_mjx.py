"""MJX runs MuJoCo's workflows by one word, a whole batch in one compiled call."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from unicon_core.errors import MissingDependencyError, ModelError
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import load_workflow


def test_without_it_the_install_command_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
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

    def test_64_robots_walk_in_one_graph(self) -> None:
        told = ["platform=mjx", "num_robots=64", "scene.initial_pose=policy:walk"]
        workflow = load_workflow("go2_walk", told)
        runner = Runner(workflow, RunOptions(speed="max"))
        try:
            for _ in range(3):
                runner.tick(0)
            assert workflow.states.joint_pos.shape == (64, 12)
            apart = np.ptp(workflow.states.joint_pos, axis=0).max()
            assert apart < 1e-4
        finally:
            runner.close()

    def test_a_model_that_it_cannot_simulate_is_named(self, tmp_path: Path) -> None:

        text = (Path(__file__).parents[2] / "config/models/go2/go2.xml").read_text()
        path = tmp_path / "sparse.xml"
        path.write_text(text.replace("<option ", '<option solver="PGS" '), encoding="utf-8")
        with pytest.raises(
            ModelError, match=r"^platform 'mjx' cannot simulate model .*sparse\.xml"
        ):
            load_workflow("go2_stand", ["platform=mjx", f"scene.model={path}"])
