"""unitree_rl_gym's deployment files: what they say, what their programs add, what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from policy_helpers import JOINTS, robot, write_linear

from unicon_base.errors import PolicyError
from unicon_core.policies import import_policy, load_policy

SHARED: dict[str, Any] = {
    "policy_path": "{LEGGED_GYM_ROOT_DIR}/deploy/pre_train/toy/motion.onnx",
    "kps": [100, 40],
    "kds": [2, 1],
    "default_angles": [0.2, -0.4],
    "ang_vel_scale": 0.25,
    "dof_pos_scale": 1.0,
    "dof_vel_scale": 0.05,
    "action_scale": 0.25,
    "cmd_scale": [2.0, 2.0, 0.25],
    "num_actions": 2,
    "num_obs": 17,
}
MUJOCO = {
    **SHARED,
    "xml_path": "{LEGGED_GYM_ROOT_DIR}/resources/robots/toy/scene.xml",
    "simulation_dt": 0.002,
    "control_decimation": 10,
    "cmd_init": [0.5, 0, 0],
}
REAL = {
    **SHARED,
    "control_dt": 0.02,
    "msg_type": "hg",
    "imu_type": "torso",
    "leg_joint2motor_idx": [2, 0],
    "arm_waist_joint2motor_idx": [1, 3],
    "arm_waist_kps": [300, 50],
    "arm_waist_kds": [3, 0.5],
    "arm_waist_target": [0.1, 0.3],
    "max_cmd": [0.8, 0.5, 1.57],
}


def write(root: Path, values: dict[str, Any], kind: str = "real", **changes: Any) -> Path:
    """A checkout's files; None removes a key."""
    said = {key: value for key, value in {**values, **changes}.items() if value is not None}
    path = root / "deploy" / f"deploy_{kind}" / "configs" / "toy.yaml"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(yaml.safe_dump(said), "utf-8")
    write_linear(root / "deploy" / "pre_train" / "toy" / "motion.onnx", 17, 2)
    return path


def test_motors_are_named_by_the_robot_and_the_others_are_held(tmp_path: Path) -> None:
    path = write(tmp_path, REAL)
    contract = load_policy(path, robot=robot())
    # Motors 2, 0, then 1, 3 of the robot.
    assert contract.joints == ("b_hip", "a_hip", "a_knee", "b_knee")
    assert contract.action.joints == ("b_hip", "a_hip")
    assert contract.stiffness.tolist() == [100.0, 40.0, 300.0, 50.0]
    assert contract.damping.tolist() == [2.0, 1.0, 3.0, 0.5]
    assert contract.default_joint_pos == pytest.approx([0.2, -0.4, 0.1, 0.3])
    assert contract.period == 0.02
    assert contract.model == tmp_path / "deploy" / "pre_train" / "toy" / "motion.onnx"
    assert [(term.state, term.index) for term in contract.terms] == [
        ("base_ang_vel", None), ("projected_gravity", None), ("velocity_command", None),
        ("joint_pos", (0, 1)), ("joint_vel", (0, 1)), ("action", None), ("gait_phase", None),
    ]  # fmt: skip
    assert contract.terms[2].scale.tolist() == [2.0, 2.0, 0.25]
    assert contract.phase is not None
    assert contract.phase.period == 0.8
    assert contract.phase.offsets == (0.0,)
    assert contract.action.feedback == "raw"
    assert contract.command_ranges["ang_vel_z"] == pytest.approx((-1.57, 1.57))
    assert any("turns the IMU's readings" in note for note in contract.notes)
    without = {key: None for key in REAL if key.startswith("arm_waist")}
    alone = load_policy(write(tmp_path, REAL, **without), robot=robot())
    assert alone.joints == ("b_hip", "a_hip")
    assert alone.terms[3].index is None


def test_the_joints_of_a_model_are_asked_for(tmp_path: Path) -> None:
    path = write(tmp_path, MUJOCO, "mujoco")
    with pytest.raises(PolicyError) as caught:
        load_policy(path, robot=robot())
    assert str(caught.value) == (
        f"{path}: the unitree_rl_gym configuration does not say joints (the joint names in policy "
        "order; the 2 of scene.xml, in its order); give it under 'given' in the workflow, with the "
        "keys of policy.yaml"
    )
    contract = load_policy(path, given={"joints": ["b_hip", "a_hip"]})
    assert contract.period == pytest.approx(0.02)
    assert contract.action.joints == ("b_hip", "a_hip")
    with pytest.raises(PolicyError, match="given joints has 4 names, and num_actions is 2"):
        load_policy(path, given={"joints": list(JOINTS)})


def test_an_import_is_the_same_policy(tmp_path: Path) -> None:
    path = write(tmp_path, REAL)
    again = load_policy(import_policy(path, tmp_path / "out", robot=robot()).path)
    first = load_policy(path, robot=robot())
    assert again.joints == first.joints
    np.testing.assert_array_equal(again.stiffness, first.stiffness)
    assert [t.index for t in again.terms] == [t.index for t in first.terms]
    assert again.phase == first.phase


def test_the_network_beside_it_is_taken_and_one_elsewhere_is_not(tmp_path: Path) -> None:
    path = write(tmp_path, REAL, policy_path="/somewhere/else/motion.pt")
    with pytest.raises(PolicyError, match=r"policy_path names motion\.pt, which is not beside toy"):
        load_policy(path, robot=robot())
    write_linear(path.parent / "motion.onnx", 17, 2)
    contract = load_policy(path, robot=robot())
    assert contract.model == path.parent / "motion.onnx"
    assert any("motion.pt, which is not there; motion.onnx is taken" in n for n in contract.notes)
    outside = tmp_path / "elsewhere.onnx"
    (path.parent / "motion.onnx").rename(outside)
    (path.parent / "motion.onnx").symlink_to(outside)
    write(tmp_path, REAL, policy_path="motion.onnx")
    with pytest.raises(PolicyError, match=r"policy_path names motion\.onnx, which is not beside"):
        load_policy(path, robot=robot())


def test_several_files_in_a_folder_are_named(tmp_path: Path) -> None:
    path = write(tmp_path, REAL)
    assert load_policy(path.parent, robot=robot()).name == "toy"
    path.with_name("other.yaml").write_text(path.read_text("utf-8"), "utf-8")
    with pytest.raises(PolicyError) as caught:
        load_policy(path.parent, robot=robot())
    assert str(caught.value) == (
        f"{path.parent}: 2 policies are in this folder; name the file of one: other.yaml, toy.yaml"
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"num_actions": None}, "the unitree_rl_gym configuration has no 'num_actions'; add it"),
        ({"num_actions": -2}, "num_actions is -2; write a whole number from 1"),
        ({"kps": [1.0, 2.0, 3.0]}, "kps has 3 values for the 2 of num_actions; give 2"),
        ({"kps": ["a", 1.0]}, "kps.0 is 'a'; write a number"),
        ({"kds": [float("nan"), 1.0]}, "kds.0 is nan; write a number"),
        ({"kds": [-1.0, 1.0]}, "damping.0 is -1.0; write a number from 0 to 200"),
        ({"arm_waist_kps": [1.0]}, "arm_waist_kps has 1 values; give 2"),
        ({"leg_joint2motor_idx": [0, 0]}, "leg_joint2motor_idx names 0 twice; name each"),
        ({"leg_joint2motor_idx": [0, 1]}, "motor 1 stands in both; name each motor once"),
        ({"leg_joint2motor_idx": [0, 12]}, "names motor 12, but robot 'toy' has 4 motors"),
        (
            {"leg_joint2motor_idx": [0]},
            "leg_joint2motor_idx has 1 values for the 2 of num_actions; give 2",
        ),
        ({"control_dt": -0.02}, "period is -0.02; write a number from 1e-06 to 1000 [s]"),
        ({"control_dt": "fast"}, "control_dt is 'fast'; write a number"),
        ({"cmd_scale": [2.0]}, "cmd_scale has 1 values; give 3"),
        ({"num_obs": 15}, "num_obs is 15, and what deploy_mujoco.py and deploy_real.py lay out"),
        ({"policy_path": 3}, "policy_path is 3; name a network (.onnx, .pt, .pth, .jit)"),
        ({"max_cmd": [-1.0, 0.5, 1.0]}, "command_ranges.lin_vel_x is [1, -1]; the lowest must"),
    ],
)
def test_mistakes_get_one_line(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    path = write(tmp_path, REAL, **changes)
    with pytest.raises(PolicyError) as caught:
        load_policy(path, robot=robot())
    assert message in str(caught.value)
    assert str(caught.value).startswith(f"{path}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("decimation", [-10, 0, 2.5, True, "ten"])
def test_a_decimation_that_is_none_is_refused(tmp_path: Path, decimation: Any) -> None:
    path = write(tmp_path, MUJOCO, "mujoco", control_decimation=decimation, simulation_dt=-0.002)
    with pytest.raises(PolicyError, match=r"control_decimation is .*; write a whole number from 1"):
        load_policy(path, given={"joints": ["a_hip", "b_hip"]})
