"""mjlab's tracking task: a network and a motion in the layout that its exporters write.

From mujocolab/mjlab `tasks/tracking/rl/exporter.py` (metadata; inputs and outputs),
`tasks/tracking/tracking_env_cfg.py` (terms) and `scripts/csv_to_npz.py` (motion).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from motion_helpers import BODIES, JOINTS, POLICY, Kinematics, model_in, motion, waisted
from policy_helpers import write_graph

from unicon_base.errors import PolicyError
from unicon_core.policies import Policy, import_policy, load_policy, policy_states
from unicon_core.states import States, standard_states

pytest.importorskip("mujoco", reason="anchors are found in a model")
pytest.importorskip("onnxruntime", reason="the networks are ONNX")

TERMS = {
    "command": 8, "motion_anchor_pos_b": 3, "motion_anchor_ori_b": 6, "base_lin_vel": 3,
    "base_ang_vel": 3, "joint_pos": 4, "joint_vel": 4, "actions": 4,
}  # fmt: skip
SIZE = sum(TERMS.values())
POSE = [0.125, -0.25, 0.5, 0.75]
METADATA = {
    "run_path": "run-9",
    "joint_names": ",".join(POLICY),
    "joint_stiffness": "40.000,30.000,20.000,10.000",
    "joint_damping": "4.000,3.000,2.000,1.000",
    "default_joint_pos": ",".join(f"{angle:.3f}" for angle in POSE),
    "command_names": "motion",
    "observation_names": ",".join(TERMS),
    "action_scale": "0.500,0.250,0.125,1.000",
}
NAMED = {"anchor_body_name": "torso", "body_names": "pelvis,torso"}
GIVEN = {"period": 0.02, "observation.scale": 1.0}


def write_policy(folder: Path, metadata: dict[str, str], moved: dict[str, Any]) -> Path:
    """Write a network whose action is 10 times the joint velocities that it sees."""
    pick = np.zeros((SIZE, 4))
    place = SIZE - 8
    pick[place : place + 4] = 10.0 * np.eye(4)
    nodes = [
        "actions = MatMul(obs, pick)", "flat = Reshape(time_step, one)",
        "whole = Min(flat, last)", "step = CastLike(whole, index)",
    ]  # fmt: skip
    kept = [BODIES.index(name) for name in NAMED["body_names"].split(",")]
    last = len(moved["joint_pos"]) - 1
    constants: dict[str, Any] = {
        "pick": pick, "one": np.array([1]), "last": np.float32(last), "index": np.array([0])
    }  # fmt: skip
    shapes = {"obs": [1, SIZE], "time_step": [1, 1], "actions": [1, 4]}
    for name, frames in moved.items():
        if name == "fps":
            continue
        table = frames[:, kept] if name.startswith("body") else frames
        nodes.append(f"{name} = Gather(all_{name}, step)")
        constants[f"all_{name}"] = table
        shapes[name] = [1, *table.shape[1:]]
    path = folder / "policy.onnx"
    inputs = ["obs", "time_step"]
    write_graph(path, "\n".join(nodes), inputs, shapes, constants, list(metadata.items()))
    return path


@pytest.fixture
def moved(tmp_path: Path) -> dict[str, Any]:
    """The motion, which also lies in the folder as the task takes it."""
    frames: dict[str, Any] = motion()
    np.savez(tmp_path / "walk.npz", **frames)
    return frames


@pytest.mark.parametrize("named", [True, False])
@pytest.mark.parametrize("file", [True, False])
def test_it_sees_what_the_task_computes(
    tmp_path: Path, moved: dict[str, Any], named: bool, file: bool
) -> None:
    path = write_policy(tmp_path, METADATA | (NAMED if named else {}), moved)
    given: dict[str, Any] = dict(GIVEN)
    if not named:
        given["motion"] = {"anchor_body": "torso", "bodies": ["pelvis", "torso"]}
    if file:
        given["motion"] = {**given.get("motion", {}), "file": "walk.npz"}
    contract = load_policy(path, given=given)
    assert contract.joints == tuple(POLICY)
    states = States({**standard_states(JOINTS), **policy_states(contract, JOINTS)})
    policy = Policy(contract, states, waisted(), model=model_in(tmp_path))
    kinematics, rng = Kinematics(), np.random.default_rng(4)
    last = np.zeros(4)
    for k in range(5):
        base = np.array([1.0, 2.0, 0.75])
        states.base_pos_w, states.base_quat = base, [np.cos(0.2), 0.0, 0.0, np.sin(0.2)]
        states.joint_pos, states.joint_vel = rng.uniform(-1.0, 1.0, (2, 4))
        states.base_lin_vel, states.base_ang_vel = rng.normal(size=(2, 3))
        policy()
        pos, vel = (
            dict(zip(JOINTS, v.astype(float))) for v in (states.joint_pos, states.joint_vel)
        )
        place, _, matrix = (part[2] for part in kinematics(base, states.base_quat, pos))
        goal, quat = moved["body_pos_w"][k, 2], moved["body_quat_w"][k, 2]
        if k == 0:  # both begin at one place with one heading
            turned = matrix_of(quat)
            angle = np.arctan2(matrix[1, 0], matrix[0, 0]) - np.arctan2(turned[1, 0], turned[0, 0])
            c, s = np.cos(angle), np.sin(angle)
            turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
            begun, there = goal * (1, 1, 0), place * (1, 1, 0)
        seen_at = matrix.T @ (turn @ (goal - begun) + there - place)
        rotation = matrix.T @ turn @ matrix_of(quat)
        own = np.array([[pos[name], vel[name]] for name in POLICY])
        frame = np.concatenate([
            moved["joint_pos"][k], moved["joint_vel"][k], seen_at, rotation[:, :2].ravel(),
            states.base_lin_vel, states.base_ang_vel, own[:, 0] - POSE, own[:, 1], last,
        ])  # fmt: skip
        np.testing.assert_allclose(states.observation, frame, atol=3e-5)
        last = 10.0 * own[:, 1]
        np.testing.assert_allclose(states.action, last, atol=1e-5)
        target = dict(zip(POLICY, POSE + np.array([0.5, 0.25, 0.125, 1.0]) * last))
        expected = [target[name] for name in JOINTS]
        np.testing.assert_allclose(states.joint_pos_target, expected, atol=1e-5)


def matrix_of(quat: Any) -> Any:
    """The rotation of a quaternion wxyz."""
    w, x, y, z = quat
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


def test_a_file_without_its_anchor_asks_for_it(tmp_path: Path, moved: dict[str, Any]) -> None:
    path = write_policy(tmp_path, METADATA, moved)
    with pytest.raises(PolicyError, match=r"does not say motion \(anchor_body, .* compared\)") as e:
        load_policy(path, given=GIVEN)
    assert "\n" not in str(e.value)
    report = import_policy(path, tmp_path / "out", given=GIVEN)
    assert "motion" in report.missing


def test_a_motion_of_other_joints_is_refused(tmp_path: Path, moved: dict[str, Any]) -> None:
    np.savez(tmp_path / "walk.npz", **{**moved, "joint_pos": moved["joint_pos"][:, ::-1]})
    path = write_policy(tmp_path, METADATA | NAMED, moved)
    contract = load_policy(path, given={**GIVEN, "motion.file": "walk.npz"})
    states = States({**standard_states(JOINTS), **policy_states(contract, JOINTS)})
    with pytest.raises(PolicyError, match="no body of it is where its joints put torso"):
        Policy(contract, states, waisted(), model=model_in(tmp_path))
