"""A policy that LeRobot's own class trained runs from its folder, in chunks: UNICON_LEROBOT."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from unicon_base.errors import PolicyError
from unicon_core.policies import load_policy
from unicon_core.policies.load import import_policy, load_network
from unicon_core.policies.networks import Tensor, remote_server
from unicon_core.policies.networks.remote import contract_hash
from unicon_core.robots import load_robot
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import Program

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
    for kind, shape in (("diffusion", [3, 8, 8]), ("act", [1, 8, 8]), ("act", None), ("act", [])):
        picture = {"observation.images.front": {"type": "VISUAL", "shape": shape}}
        with pytest.raises(PolicyError, match=r"images\.front is a picture, which ACT alone"):
            loaded(tmp_path, type=kind, input_features=picture)
    features = {"observation.images.front": {"type": "VISUAL", "shape": [3, -8, 8]}}
    features["observation.state"] = {"type": "STATE", "shape": [6]}
    given = {key: GIVEN[key] for key in GIVEN if key != "observation"}
    with pytest.raises(PolicyError, match=r"images\.front_image\.size\.0 is -8"):
        loaded(tmp_path, given, input_features=features)
    with pytest.raises(PolicyError, match="policies that run are"):
        loaded(tmp_path, type="tdmpc")
    with pytest.raises(PolicyError, match="runs as it is"):
        import_policy(folder_of(tmp_path), tmp_path / "out")


def whole_folder(where: Path) -> Path:
    """Write such a folder with its pipelines and their normalisation, as if it had been saved."""
    folder_of(where)
    for name in ("preprocessor", "postprocessor"):
        (where / f"policy_{name}.json").write_text('{"steps": []}', "utf-8")
        (where / f"policy_{name}_step_3.safetensors").write_bytes(b"mean, std")
    return where


FILES = (
    "config.json",
    "model.safetensors",
    "policy_preprocessor.json",
    "policy_postprocessor_step_3.safetensors",
)


@pytest.mark.parametrize("name", FILES)
def test_the_hash_is_over_network_configuration_and_normalisation(tmp_path: Path, name: str):
    contract = load_network(whole_folder(tmp_path))
    before = contract_hash(contract)
    given = loaded(tmp_path)
    (tmp_path / "README.md").write_text("of no matter", "utf-8")
    (tmp_path / "policy_preprocessor.json").write_text('{"steps": []}', "utf-8")
    assert contract_hash(given) == before == contract_hash(contract)
    path = tmp_path / name
    path.write_bytes(path.read_bytes() + b" ")
    assert contract_hash(contract) != before


def test_a_folder_without_its_pipelines_is_not_served(tmp_path: Path):
    (whole_folder(tmp_path) / "policy_postprocessor.json").unlink()
    told = r"policy_postprocessor\.json: no such file; copy the whole folder"
    with pytest.raises(PolicyError, match=told):
        contract_hash(load_network(tmp_path))


class Ramps:
    """In place of LeRobot's network: row i is the joints that it sees plus i / 100."""

    def __init__(self, contract: Any) -> None:
        self.inputs = (Tensor("observation", "float32", (1, 9)),)
        self.outputs = (Tensor("action", "float32", (1, contract.chunk.size, 6)),)

    def bind(self, inputs: Any, outputs: Any) -> Any:
        def run() -> None:
            rows = np.arange(outputs["action"].shape[1], dtype=np.float32)[:, None] / 100
            outputs["action"][0] = inputs["observation"][0, :6] + rows

        return run


def arm(where: Path, address: str, **more: Any) -> dict[str, Any]:
    """Return a workflow whose arm asks a server for chunks, and holds after an underrun."""
    given = {**GIVEN, "chunk": {"underrun": "done", "hold": 0.1, "steps": 4}}
    given["observation"] = {"terms": {"environment_state": {"state": "base_lin_vel"}}}
    entry = {"path": str(where), "given": given, "remote": {"address": address}}
    return {
        "robot": "arx_x5",
        "platform": "fake",
        "rate": 100,
        "policies": {"reach": entry},
        "flow": {"chain": [{"policy": "reach"}, "hold"]},
        "safety": ["finite", "joint_limits"],
        **more,
    }


@contextmanager
def served(where: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """A server of a folder, in a thread, with `Ramps` for its network."""
    monkeypatch.setattr(remote_server, "open_network", Ramps)
    with closing(remote_server.PolicyServer(load_network(where), "tcp://127.0.0.1:*")) as server:
        thread = threading.Thread(target=server.run)
        thread.start()
        try:
            yield server
        finally:
            server.stop()
            thread.join()


def test_a_robot_without_torch_asks_a_server_for_chunks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setitem(sys.modules, "torch", None)
    with served(whole_folder(tmp_path), monkeypatch) as server:
        program = Program(**arm(tmp_path, server.address))
        runner = Runner(program, RunOptions(speed="max", warn=lambda _: None))
        with closing(program):
            for _ in range(3):
                runner.tick(0)
            seen = program.states["observation"][:6].copy()
            for _ in range(10):  # two rows of 50 ms
                runner.tick(0)
            np.testing.assert_allclose(program.states["action"], seen + 0.02, atol=1e-6)
        (tmp_path / "config.json").write_bytes((tmp_path / "config.json").read_bytes() + b" ")
        with pytest.raises(PolicyError, match="give both the same network"):
            Program(**arm(tmp_path, server.address))


def test_pictures_are_states_of_cameras(tmp_path: Path):
    names = ("observation.images.front", "observation.images.Wrist.left", "observation.image")
    features = {name: {"type": "VISUAL", "shape": [3, 96, 128]} for name in names}
    features["observation.state"] = {"type": "STATE", "shape": [6]}
    handles = {"front_image": {"handle": "webcam_handle", "max_age": 0.2}}
    given = {key: GIVEN[key] for key in GIVEN if key != "observation"} | {"images": handles}
    contract = loaded(tmp_path, given, input_features=features)
    assert contract.inputs == {
        "observation": "observation",
        "front_image": "observation.images.front",
        "wrist_left_image": "observation.images.Wrist.left",
        "rgb_image": "observation.image",
    }
    front, wrist = contract.images["front_image"], contract.images["wrist_left_image"]
    assert (front.shape, front.handle, front.max_age) == ((3, 96, 128), "webcam_handle", 0.2)
    assert wrist.handle == "camera_handle"
    assert [term.state for term in contract.terms] == ["joint_pos"]


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


REACH = str(ROOT / "tools/chunks/reach_act.py")


@pytest.fixture(scope="module")
def reached(package: None, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any]:
    """A folder in which an arm has learned to reach, and what it reached."""
    out = tmp_path_factory.mktemp("reach")
    return out, json.loads(ran(REACH, str(out)))


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
@pytest.mark.parametrize("kind", ["act", "diffusion", "pictures"])
def test_a_folder_answers_as_its_own_class_does(tmp_path: Path, kind: str):
    ran(str(Path(__file__).with_name("lerobot_folder.py")), str(tmp_path), kind)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_an_arm_reaches_its_goals_by_chunks_at_ten_hertz(reached: tuple[Path, Any]):
    found = reached[1]
    assert found["faults"] == []
    assert found["goals"] == 20
    assert found["reached"] >= 18, found


def asked(out: Path, *more: str) -> Any:
    """Let the robot run in this Python, which needs no LeRobot, and the server in that one."""
    command = [sys.executable, REACH, str(out), "--serve", PYTHON, *more]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "HF_HUB_OFFLINE": "1"}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, (done.stdout[-1000:], done.stderr[-2000:])
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_an_arm_reaches_its_goals_over_a_link_of_80_ms(reached: tuple[Path, Any]):
    found = asked(reached[0], "--delay", "0.08")
    assert found["faults"] == []
    assert found["round_trip_ms"]["p50"] > 80.0
    assert found["goals"] == 20
    assert found["reached"] >= 18, found


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("failure", ["kill", "stop", "garbage"])
def test_an_arm_stands_when_its_server_fails(reached: tuple[Path, Any], failure: str):
    found = asked(reached[0], "--delay", "0.08", "--fail", failure)
    assert (found["ended"], found["faults"]) == ("duration", [])
    assert 0.4 < found["oldest"] <= 0.75  # a chunk of ten rows of 50 ms, and what it is held
    assert found["moved"] < 2e-3
