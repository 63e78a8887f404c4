"""A policy that LeRobot's own class trained runs from its folder, in chunks: UNICON_LEROBOT."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from unicon_base.errors import PolicyError
from unicon_core.policies import load_policy
from unicon_core.policies.load import import_policy
from unicon_core.robots import load_robot

ROOT = Path(__file__).resolve().parents[2]
PYTHON = os.environ.get("UNICON_LEROBOT", sys.executable)
GIVEN = {
    "period": 0.05,
    "default_joint_pos": [0.0] * 6,
    "stiffness": 50.0,
    "damping": 2.0,
    "observation": {"terms": {"environment_state": {"state": "goal"}}},
}


def folder_of(where: Path, **said: Any) -> Path:
    """Write what a folder of LeRobot's says, without its weights."""
    values = {
        "type": "act",
        "n_obs_steps": 1,
        "input_features": {
            "observation.state": {"type": "STATE", "shape": [6]},
            "observation.environment_state": {"type": "ENV", "shape": [3]},
        },
        "output_features": {"action": {"type": "ACTION", "shape": [6]}},
        "chunk_size": 20,
        "n_action_steps": 5,
        "temporal_ensemble_coeff": None,
        **said,
    }
    (where / "config.json").write_text(json.dumps(values), "utf-8")
    (where / "model.safetensors").write_bytes(b"")
    return where


def loaded(where: Path, given: Any = GIVEN, **said: Any) -> Any:
    return load_policy(folder_of(where, **said), robot=load_robot("arx_x5"), given=given)


def test_the_folder_says_rows_and_terms(tmp_path: Path):
    contract = loaded(tmp_path)
    assert contract.joints == load_robot("arx_x5").joint_names
    assert (contract.chunk.size, contract.chunk.steps) == (20, 5)
    assert contract.chunk.execution == "receding"
    assert [(term.name, term.state) for term in contract.terms] == [
        ("state", "joint_pos"),
        ("environment_state", "goal"),
    ]
    other = loaded(tmp_path, {**GIVEN, "chunk": {"steps": 3, "execution": "real_time"}})
    assert (other.chunk.steps, other.chunk.execution) == (3, "real_time")
    ensemble = loaded(tmp_path, n_action_steps=1, temporal_ensemble_coeff=0.02).chunk
    assert (ensemble.execution, ensemble.weight, ensemble.steps) == ("ensemble", 0.02, 1)
    frames = loaded(tmp_path, type="diffusion", n_obs_steps=2, n_action_steps=8)
    assert (frames.chunk.size, frames.chunk.steps) == (8, None)
    assert [term.history for term in frames.terms] == [2, 2]
    assert frames.observation.layout == "frame_major"


def test_what_a_folder_lacks_or_cannot_be_is_refused(tmp_path: Path):
    with pytest.raises(PolicyError, match=r"does not say period .*environment_state\.state"):
        loaded(tmp_path, {})
    picture = {"observation.images.front": {"type": "VISUAL", "shape": [3, 8, 8]}}
    with pytest.raises(PolicyError, match=r"observation\.images\.front is a picture"):
        loaded(tmp_path, input_features=picture)
    with pytest.raises(PolicyError, match="policies that run are"):
        loaded(tmp_path, type="tdmpc")
    with pytest.raises(PolicyError, match="runs as it is"):
        import_policy(folder_of(tmp_path), tmp_path / "out")


@pytest.fixture(scope="module")
def package() -> None:
    """Skip without lerobot's policies."""
    done = subprocess.run(
        [PYTHON, "-c", "import lerobot.policies.factory, mujoco, daqp"],
        capture_output=True,
        check=False,
    )
    if done.returncode:
        pytest.skip("UNICON_LEROBOT: a Python with lerobot, mujoco and daqp")


def ran(*arguments: str) -> str:
    """Run that Python; return its last line."""
    path = os.pathsep.join([str(ROOT), str(ROOT / "tools/chunks"), str(Path(__file__).parent)])
    environment = {**os.environ, "PYTHONPATH": path, "HF_HUB_OFFLINE": "1"}
    done = subprocess.run(
        [PYTHON, *arguments], capture_output=True, text=True, env=environment, check=False
    )
    assert done.returncode == 0, (done.stdout[-1000:], done.stderr[-2000:])
    return done.stdout.splitlines()[-1]


@pytest.mark.slow
@pytest.mark.usefixtures("package")
@pytest.mark.parametrize("kind", ["act", "diffusion"])
def test_a_folder_answers_as_its_own_class_does(tmp_path: Path, kind: str):
    ran(str(Path(__file__).with_name("lerobot_folder.py")), str(tmp_path), kind)


@pytest.mark.slow
@pytest.mark.usefixtures("package")
@pytest.mark.timeout(1800)
def test_an_arm_reaches_its_goals_by_chunks_at_ten_hertz(tmp_path: Path):
    found = json.loads(ran(str(ROOT / "tools/chunks/reach_act.py"), str(tmp_path)))
    assert found["faults"] == []
    assert found["goals"] == 20
    assert found["reached"] >= 18, found
