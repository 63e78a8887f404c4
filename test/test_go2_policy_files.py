"""The shipped Go2 policies: network, metadata, contract, model and robot file agree; they walk."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from trainer import trainer

onnxruntime = pytest.importorskip("onnxruntime")
mujoco = pytest.importorskip("mujoco")
ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module", params=["go2_velocity", "go2_stairs"])
def folder(request: pytest.FixtureRequest) -> Path:
    return ROOT / "config" / "policies" / str(request.param)


@pytest.fixture(scope="module")
def network(folder: Path) -> Path:
    return folder / "policy.onnx"


@pytest.fixture(scope="module")
def contract(folder: Path) -> dict[str, Any]:
    return dict(yaml.safe_load((folder / "policy.yaml").read_text(encoding="utf-8")))


@pytest.fixture(scope="module")
def session(network: Path) -> Any:
    return onnxruntime.InferenceSession(str(network), providers=["CPUExecutionProvider"])


@pytest.fixture(scope="module")
def metadata(session: Any) -> dict[str, list[str]]:
    pairs = session.get_modelmeta().custom_metadata_map
    return {key: value.split(",") for key, value in pairs.items()}


def test_the_network_is_the_one_the_contract_names(
    contract: dict[str, Any], folder: Path, network: Path
) -> None:
    assert contract["name"] == folder.name
    assert folder / contract["onnx"] == network
    assert hashlib.sha256(network.read_bytes()).hexdigest() == contract["sha256"]


def test_the_network_is_smaller_than_one_megabyte(network: Path) -> None:
    assert network.stat().st_size < 1_000_000


def test_inputs_and_outputs_have_the_contracts_names_and_sizes(
    contract: dict[str, Any], session: Any
) -> None:
    given, memory = session.get_inputs()
    returned, following = session.get_outputs()
    assert contract["inputs"] == {"observation": given.name}
    assert contract["outputs"] == {"action": returned.name}
    assert contract["recurrent"] == [{"input": memory.name, "output": following.name}]
    assert memory.shape == following.shape
    sizes = {"base_ang_vel": 3, "projected_gravity": 3, "velocity_command": 3, "height_scan": 187}
    terms = contract["observation"]["terms"]
    assert given.shape[1] == sum(sizes.get(term["state"], 12) for term in terms)
    assert returned.shape[1] == len(contract["joints"]) == 12


def test_every_observation_can_be_measured_on_the_real_robot(contract: dict[str, Any]) -> None:
    measurable = {"base_ang_vel", "projected_gravity", "velocity_command"}
    measurable |= {"joint_pos", "joint_vel", "action", "height_scan"}
    assert {term["state"] for term in contract["observation"]["terms"]} <= measurable


def test_metadata_and_contract_agree(
    contract: dict[str, Any], metadata: dict[str, list[str]]
) -> None:
    assert metadata["joint_names"] == contract["joints"]
    for key, value in (
        ("joint_stiffness", contract["stiffness"]),
        ("joint_damping", contract["damping"]),
        ("default_joint_pos", contract["default_joint_pos"]),
        ("action_scale", [contract["action"]["scale"]] * 12),
    ):
        np.testing.assert_allclose([float(x) for x in metadata[key]], value)
    names = [term["name"] for term in contract["observation"]["terms"]]
    assert metadata["observation_names"] == names
    assert metadata["command_names"] == ["velocity_command"]


def test_joints_are_the_robots_and_the_pose_is_its_standing_pose(contract: dict[str, Any]) -> None:
    robot = yaml.safe_load((ROOT / "config" / "robots" / "go2.yaml").read_text(encoding="utf-8"))
    standing = {joint["name"]: joint["default"] for joint in robot["joints"]}
    assert contract["robot"] == robot["name"]
    assert dict(zip(contract["joints"], contract["default_joint_pos"])) == standing


def test_it_accepts_batches_and_answers_finitely(session: Any) -> None:
    rng = np.random.default_rng(0)
    batch = {
        given.name: rng.standard_normal((5, given.shape[1])).astype(np.float32)
        for given in session.get_inputs()
    }
    actions, memory = session.run(None, batch)
    assert actions.shape == (5, 12)
    assert memory.shape == (5, session.get_inputs()[1].shape[1])
    assert np.isfinite(actions).all()


@pytest.fixture(scope="module")
def walker(folder: Path) -> Any:
    (module,) = trainer("walker")
    model = mujoco.MjModel.from_xml_path(str(ROOT / "config" / "models" / "go2" / "go2.xml"))
    return module.Walker(model, folder)


def test_it_walks_where_it_is_told(walker: Any) -> None:
    walker.reset()
    for _ in range(150):
        walker.tick(np.array([0.6, 0.0, 0.0]))
        assert not walker.fallen()
    assert walker.data.qpos[0] > 1.2
    assert abs(walker.yaw) < 0.4


def test_it_turns_where_it_is_told(walker: Any) -> None:
    walker.reset()
    turned = 0.0
    for _ in range(150):
        walker.tick(np.array([0.0, 0.0, 0.8]))
        turned += walker.data.qvel[5] * 0.02
        assert not walker.fallen()
    assert turned > 1.6


def test_it_stands_still_without_a_command(walker: Any) -> None:
    walker.reset()
    for _ in range(150):
        walker.tick(np.zeros(3))
    assert np.linalg.norm(walker.data.qpos[:2]) < 0.1
    assert np.abs(walker.data.qvel[6:]).mean() < 0.1
