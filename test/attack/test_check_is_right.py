"""`unicon check` passes contracts as they are published; what is unusual in them is a note."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("mujoco", reason="the checks are run on a model")
pytest.importorskip("onnxruntime", reason="the policies need onnxruntime")
pytest.importorskip("onnx", reason="the test networks are written with onnx")

from toy_workflows import check, codes, note_of, write_workflow

from unicon_core.check import check_workflow
from unicon_core.check.twin.perturb import perturbations
from unicon_core.policies import load_policy


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "toy"


def _term(name: str, state: str, **more: Any) -> dict[str, Any]:
    return {"name": name, "state": state, **more}


# As in Unitree's rl_mjlab and BeyondMimic: the scale of a joint is 0.25 · effort / stiffness, and
# a command that is not trained has the scale 0.
MJLAB: Mapping[str, Any] = {
    "stiffness": [20.0, 20.0, 40.0] * 4,
    "damping": [1.0, 1.0, 2.0] * 4,
    "action.scale": [0.25 * 23.7 / 20.0, 0.25 * 23.7 / 20.0, 0.25 * 45.43 / 40.0] * 4,
    "observation.terms": [
        _term("base_ang_vel", "base_ang_vel"),
        _term("projected_gravity", "projected_gravity"),
        _term("command", "velocity_command", scale=[1.0, 0.0, 1.0]),
        _term("joint_pos", "joint_pos", subtract="default_joint_pos"),
        _term("joint_vel", "joint_vel"),
        _term("actions", "action"),
    ],
}
# As in holosoma: scales of terms, and joints (there wrists) that stay at their default.
HOLOSOMA: Mapping[str, Any] = {
    "action.scale": [0.0, 0.25, 0.25] * 4,
    "observation.terms": [
        _term("actions", "action"),
        _term("base_ang_vel", "base_ang_vel", scale=0.25),
        _term("command", "velocity_command"),
        _term("dof_pos", "joint_pos", subtract="default_joint_pos"),
        _term("dof_vel", "joint_vel", scale=0.05),
        _term("gravity", "projected_gravity"),
    ],
}
# As in mujoco_playground's T1 and in policies whose actions are radians: a scale of 1.
RADIANS: Mapping[str, Any] = {"action.scale": 1.0, "stiffness": 75.0, "damping": 2.0}


@pytest.mark.parametrize(
    ("contract", "told"),
    [
        (MJLAB, {"observation.scale": "scale is 0 at 1 of 3 elements"}),
        (HOLOSOMA, {"action.scale": "0 at FL_hip_joint, FR_hip_joint"}),
        (RADIANS, {"action.torque": "75 · 1 = 75 N·m, and its effort limit is 23.7"}),
    ],
    ids=["rl_mjlab", "holosoma", "playground"],
)
def test_published_contracts_are_clean_and_what_is_unusual_is_a_note(
    folder: Path, contract: Mapping[str, Any], told: Mapping[str, str]
) -> None:
    result = check(folder, contract)
    assert result.clean, result.text()
    for code, text in told.items():
        assert text in note_of(result, code)


def test_a_scale_of_one_on_a_narrow_joint_is_a_note(folder: Path) -> None:
    narrow = {
        f"joints.{i}.{key}": v for i in (0, 3) for key, v in (("lower", -0.4), ("upper", 0.4))
    }
    result = check(folder, {**RADIANS, "stiffness": 20.0}, robot=narrow)
    assert result.clean, result.text()
    assert "by 1 rad, and its whole range is 0.8 (2 joints)" in note_of(result, "action.scale")


def test_joints_that_damp_themselves_need_no_damping_in_simulation(
    folder: Path, assets: Path
) -> None:
    """As mujoco_playground's Go1: stiffness 35, damping 0.5 in the model's joints."""
    model = {"models": {"mjcf": "assets:models/go1/go1.xml"}}
    contract = {"stiffness": 35.0, "damping": 0.0, "action.scale": 0.5}
    path = write_workflow(folder, contract, None, model)
    result = check_workflow(path)
    assert "gains.damping" not in codes(result), result.text()
    assert "the model's joints damp themselves" in note_of(result, "gains.damping")
    on_hardware = check_workflow(path, ["platform=ros"])
    assert "gains.damping" in codes(on_hardware), on_hardware.text()
    replaced = check_workflow(path, ["platforms.mujoco.passive=replace"])
    assert "gains.damping" in codes(replaced), replaced.text()


def test_damping_that_counts_twice_is_told_with_its_joints(assets: Path) -> None:
    result = check_workflow("go1_walk")
    assert result.clean, result.text()  # it walks all the same
    note = note_of(result, "gains.passive")
    assert "12 of 12 joints damp themselves beside the policy's damping" in note
    assert "platforms: {mujoco: {passive: replace}}" in note
    for changes in (["platforms.mujoco.passive=replace"], ["policies.walk.given.damping=2.0"]):
        assert "gains.passive" not in [n.code for n in check_workflow("go1_walk", changes).notes]


def test_a_policy_that_only_stands_up_is_not_suspect(folder: Path) -> None:
    terms = [_term("gravity", "projected_gravity"), _term("v", "joint_vel", scale=0.05)]
    path = write_workflow(folder, {"observation.terms": terms}, inputs=15)
    result = check_workflow(path, ["check.duration=1"], twin=True)
    assert result.clean, result.text()
    assert "the network hardly responds" in note_of(result, "twin.suspect")


def test_scales_that_are_one_are_doubled_by_nobody(folder: Path) -> None:
    write_workflow(folder, MJLAB | {"observation.terms.2.scale": 1.0})
    contract = load_policy(folder / "policy")
    broken = perturbations(contract, [1, 2, 3] * 4)
    unlikely = [each.name for each in broken if each.unlikely]
    assert unlikely == ["observation scales doubled (all are 1)"]


@pytest.mark.parametrize("scale", [1.2, 5.0])
def test_a_scale_beyond_radians_on_a_narrow_joint_stays_an_error(
    folder: Path, scale: float
) -> None:
    narrow = {
        f"joints.{i}.{key}": v for i in (0, 3) for key, v in (("lower", -0.4), ("upper", 0.4))
    }
    assert "action.scale" in codes(check(folder, {"action.scale": scale}, robot=narrow))
