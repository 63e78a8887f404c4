"""rl_sar's config.yaml and base.yaml: what they say, what its program adds, what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from policy_helpers import JOINTS, robot, write_linear

from unicon_base.errors import PolicyError
from unicon_core.policies import Policy, import_policy, load_policy, policy_states
from unicon_core.states import States, standard_states

BASE: dict[str, Any] = {
    "dt": 0.005,
    "decimation": 4,
    "fixed_kp": [80.0] * 4,
    "num_of_dofs": 4,
    "wheel_indices": [],
    "default_dof_pos": [9.0] * 4,
    "joint_names": list(JOINTS),
    "joint_mapping": [0, 1, 2, 3],
}
CONFIG: dict[str, Any] = {
    "model_name": "policy.onnx",
    "num_observations": 21,
    "observations": ["ang_vel", "gravity_vec", "commands", "dof_pos", "dof_vel", "actions"],
    "observations_history": [2, 1, 0],
    "observations_history_priority": "time",
    "clip_obs": 100.0,
    "clip_actions_lower": [-1.0, -2.0, -3.0, -4.0],
    "clip_actions_upper": [1.0, 2.0, 3.0, 4.0],
    "rl_kp": [20.0, 20.0, 20.0, 0.0],
    "rl_kd": [0.5, 0.5, 0.5, 0.4],
    "fixed_kp": [80.0] * 4,
    "num_of_dofs": 4,
    "action_scale": [0.125, 0.25, 0.25, 5.0],
    "wheel_indices": [3],
    "lin_vel_scale": 2.0,
    "ang_vel_scale": 0.25,
    "dof_pos_scale": 1.0,
    "dof_vel_scale": 0.05,
    "commands_scale": [2.0, 2.0, 0.25],
    "torque_limits": [23.5] * 4,
    "default_dof_pos": [0.1, 0.8, -0.1, 0.0],
    "joint_mapping": [2, 3, 0, 1],
}


def write(root: Path, base: dict[str, Any] | None = BASE, **changes: Any) -> Path:
    """A robot's folder with one policy; None removes a key."""
    folder = root / "toy" / "walk"
    folder.mkdir(parents=True, exist_ok=True)
    said = {key: value for key, value in {**CONFIG, **changes}.items() if value is not None}
    if base is not None:
        (root / "toy" / "base.yaml").write_text(yaml.safe_dump({"toy": base}), "utf-8")
    path = folder / "config.yaml"
    path.write_text(yaml.safe_dump({"toy/walk": said}), "utf-8")
    write_linear(folder / "policy.onnx", 63, 4)
    return path


def test_config_wins_over_base_and_the_mapping_names_the_joints(tmp_path: Path) -> None:
    contract = load_policy(write(tmp_path))
    assert contract.name == "walk"
    assert contract.period == pytest.approx(0.02)
    assert contract.joints == ("b_hip", "b_knee", "a_hip", "a_knee")
    assert contract.stiffness.tolist() == [20.0, 20.0, 20.0, 0.0]
    assert contract.default_joint_pos == pytest.approx([0.1, 0.8, -0.1, 0.0])
    assert contract.action.kinds == ("position", "position", "position", "velocity")
    assert contract.action.feedback == "clipped"
    assert contract.action.clip is not None
    assert contract.action.clip.tolist() == [[-1.0, -2.0, -3.0, -4.0], [1.0, 2.0, 3.0, 4.0]]
    observation = contract.observation
    assert (observation.layout, observation.newest) == ("frame_major", "last")
    assert observation.start == "zeros"
    assert {term.history for term in contract.terms} == {3}
    assert contract.terms[3].scale.tolist() == [1.0, 1.0, 1.0, 0.0]
    assert contract.terms[4].clip is not None
    assert contract.terms[4].clip.tolist() == [[-2000.0], [2000.0]]
    free = load_policy(write(tmp_path, clip_actions_lower=[], clip_actions_upper=[]))
    assert free.action.clip is None


@pytest.mark.parametrize(
    ("ages", "priority", "expected"),
    [([1, 0], "time", "oldest frames first"), ([0, 1], "term", "newest first, term by term")],
)
def test_histories_lie_as_its_buffer_has_them(
    tmp_path: Path, ages: list[int], priority: str, expected: str
) -> None:
    """Beside a buffer written after observation_buffer.cpp: [0] is the newest frame."""
    path = write(
        tmp_path,
        observations=["ang_vel", "actions"],
        num_observations=7,
        observations_history=ages,
        observations_history_priority=priority,
    )
    write_linear(path.with_name("policy.onnx"), 14, 4)
    contract, machine = load_policy(path), robot()
    states = States({**standard_states(JOINTS), **policy_states(contract, machine.joint_names)})
    policy = Policy(contract, states, machine)
    buffer = np.zeros((2, 7), np.float32)
    for tick in range(3):
        states.base_ang_vel = [tick, 300.0 if tick else 0.0, -tick]
        frame = np.concatenate((0.25 * states.base_ang_vel, states.action))
        buffer = np.stack((np.clip(frame, -100.0, 100.0), buffer[0]))
        policy()
        rows = [buffer[age] for age in ages]
        parts = [row[:3] for row in rows] + [row[3:] for row in rows]
        told = np.concatenate(rows if priority == "time" else parts)
        np.testing.assert_array_equal(states.observation, told, expected)


def test_the_program_of_a_wheel_is_the_same(tmp_path: Path) -> None:
    path = write(tmp_path, observations_history=[])
    weight = write_linear(path.with_name("policy.onnx"), 21, 4)
    contract, machine = load_policy(path), robot()
    states = States({**standard_states(JOINTS), **policy_states(contract, machine.joint_names)})
    policy = Policy(contract, states, machine)
    states.joint_pos, states.joint_vel = [0.3, 0.4, 0.5, 0.6], [1.0, 2.0, 3.0, 4.0]
    states.projected_gravity, states.velocity_command = [0.0, 0.0, -1.0], [0.5, 0.0, 0.2]
    order = [2, 3, 0, 1]
    seen = (states.joint_pos[order] - np.float32([0.1, 0.8, -0.1, 0.0])) * [1, 1, 1, 0]
    frame = np.concatenate(
        (np.zeros(3), [0, 0, -1], [1.0, 0.0, 0.05], seen, states.joint_vel[order] * 0.05, [0] * 4)
    ).astype(np.float32)
    policy()
    action = np.clip(frame @ weight, [-1, -2, -3, -4], [1, 2, 3, 4])
    np.testing.assert_allclose(states.action, action, rtol=1e-5)
    scaled = action * [0.125, 0.25, 0.25, 5.0]
    target, turning = np.float32([0.1, 0.8, -0.1]) + scaled[:3], scaled[3]
    np.testing.assert_allclose(states.joint_pos_target[order[:3]], target, rtol=1e-5)
    np.testing.assert_allclose(states.joint_vel_target[1], turning, rtol=1e-5)


def test_an_import_is_the_same_policy(tmp_path: Path) -> None:
    first = load_policy(write(tmp_path))
    again = load_policy(import_policy(tmp_path / "toy" / "walk", tmp_path / "out").path)
    assert again.joints == first.joints
    assert again.action.kinds == first.action.kinds
    for a, b in zip(again.terms, first.terms):
        assert (a.name, a.history, a.subtract) == (b.name, b.history, b.subtract)
        np.testing.assert_array_equal(np.broadcast_to(a.scale, b.scale.shape), b.scale)
        assert b.clip is not None
        np.testing.assert_array_equal(np.broadcast_to(a.clip, b.clip.shape), b.clip)


def test_base_yaml_is_needed_and_is_no_policy(tmp_path: Path) -> None:
    path = write(tmp_path, None)
    with pytest.raises(PolicyError) as caught:
        load_policy(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: the rl_sar config.yaml does not say period (the control ")
    assert "joints (the joint names in policy order" in text
    assert "it stands in base.yaml, which is neither above nor beside it" in text
    given = {"period": 0.02, "joints": list(JOINTS)}
    assert load_policy(path, given=given).joints == JOINTS
    (path.parent / "base.yaml").write_text(yaml.safe_dump({"toy": BASE}), "utf-8")
    assert load_policy(path).joints[0] == "b_hip"
    with pytest.raises(PolicyError, match=r"base\.yaml has no policy; name the config\.yaml"):
        load_policy(path.parent / "base.yaml")
    (path.parent / "base.yaml").unlink()
    write(tmp_path)
    with pytest.raises(PolicyError, match=r"name the config\.yaml of one: walk/config\.yaml"):
        load_policy(tmp_path / "toy")
    (tmp_path / "toy" / "base.yaml").write_text(yaml.safe_dump({"other": BASE}), "utf-8")
    with pytest.raises(PolicyError, match=r"base\.yaml is of 'other', and config\.yaml is of 'toy"):
        load_policy(path)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"joint_mapping": [0, 1, 2]},
            "joint_mapping has 3 values for the 4 of num_of_dofs; give 4",
        ),
        ({"joint_mapping": [0, 1, 2, 2]}, "joint_mapping names 2 twice; name each once"),
        ({"joint_mapping": [0, 1, 2, 4]}, "joint_mapping.3 is 4; write a whole number from 0 to 3"),
        (
            {"joint_mapping": [0, 1, 2, -1]},
            "joint_mapping.3 is -1; write a whole number from 0 to 3",
        ),
        ({"joint_names": ["a"]}, "joint_names has 1 values for the 4 of num_of_dofs; give 4"),
        ({"rl_kd": [0.5]}, "rl_kd has 1 values for the 4 of num_of_dofs; give 4"),
        ({"rl_kp": [float("nan"), 0.0, 20.0, 0.0]}, "rl_kp.0 is nan; write a number"),
        ({"rl_kp": [20.0] * 4}, "is 20 at a_knee, which is given velocities"),
        ({"wheel_indices": [4]}, "wheel_indices.0 is 4; write a whole number from 0 to 3"),
        ({"observations": "all"}, "observations is 'all'; write a list"),
        ({"observations": ["dofs"]}, "observation.terms.dofs.state (the state that it is taken"),
        ({"num_observations": 45}, "num_observations is 45, and the terms ang_vel, gravity_vec"),
        ({"observations_history": [4, 2, 0]}, "only whole histories can be run: [0, 1, 2]"),
        ({"observations_history": [0, 0]}, "observations_history names 0 twice"),
        ({"observations_history_priority": "x"}, "priority 'x' is not known; known: term, time"),
        ({"decimation": -4}, "decimation is -4; write a whole number from 1"),
        ({"dt": -0.005}, "period is -0.02; write a number from 1e-06 to 1000 [s]"),
        ({"model_name": "../../policy.onnx"}, "model_name names policy.onnx"),
        ({"clip_obs": "yes"}, "clip_obs is 'yes'; write a number"),
        ({"clip_obs": float("nan")}, "clip_obs is nan; write a number"),
        ({"commands_scale": [1.0]}, "commands_scale has 1 values; give 3"),
        ({"ang_vel_scale": None}, "the rl_sar config.yaml has no 'ang_vel_scale'; add it"),
    ],
)
def test_mistakes_get_one_line(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    path = write(tmp_path, **changes)
    if "model_name" in changes:
        path.with_name("policy.onnx").unlink()
        write_linear(tmp_path / "policy.onnx", 63, 4)
    with pytest.raises(PolicyError) as caught:
        load_policy(path)
    assert message in str(caught.value)
    assert str(caught.value).startswith(f"{tmp_path / 'toy'}")
    assert "\n" not in str(caught.value)
