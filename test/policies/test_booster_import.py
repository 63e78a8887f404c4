"""Booster's T1.yaml: what it says, what its program adds, what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from policy_helpers import robot, write_linear

from unicon_base.errors import PolicyError
from unicon_core.policies import Policy, import_policy, load_policy, policy_states
from unicon_core.states import States, standard_states

JOINTS = ("a_hip", "a_knee", "b_hip", "b_knee")


def document() -> dict[str, Any]:
    """A configuration for four motors, of which the last two are moved."""
    return {
        "common": {
            "dt": 0.002,
            "stiffness": [20, 20, 200, 50],
            "damping": [0.2, 0.2, 5, 3],
            "default_qpos": [0.2, -1.3, 0.4, -0.25],
            "torque_limit": [7, 7, 60, 24],
        },
        "policy": {
            "policy_path": "./models/toy.onnx",
            "num_actions": 2,
            "num_observations": 17,
            "gait_frequency": 2,
            "normalization": {
                "gravity": 1.0, "lin_vel": 1.0, "ang_vel": 0.5, "dof_pos": 1.0, "dof_vel": 0.1,
                "clip_actions": 1.0,
            },
            "control": {"action_scale": 1.0, "decimation": 10},
        },
        "mech": {"parallel_mech_indexes": [3]},
    }  # fmt: skip


def write(root: Path, values: dict[str, Any] | None = None) -> tuple[Path, Any]:
    """A deploy folder; return the file and the network's weight."""
    path = root / "deploy" / "configs" / "toy.yaml"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(yaml.safe_dump(values or document()), "utf-8")
    return path, write_linear(root / "deploy" / "models" / "toy.onnx", 17, 2)


def test_the_last_motors_are_moved_and_the_clock_is_off_without_a_command(tmp_path: Path) -> None:
    path, _ = write(tmp_path)
    contract = load_policy(path, robot=robot())
    assert contract.joints == JOINTS
    assert contract.action.joints == JOINTS[2:]
    assert contract.period == pytest.approx(0.02)
    assert contract.model == tmp_path / "deploy" / "models" / "toy.onnx"
    assert [(term.state, term.index) for term in contract.terms] == [
        ("projected_gravity", None), ("base_ang_vel", None), ("velocity_command", None),
        ("gait_phase_cos", None), ("gait_phase_sin", None), ("joint_pos", (2, 3)),
        ("joint_vel", (2, 3)), ("action", None),
    ]  # fmt: skip
    assert contract.terms[2].scale.tolist() == [1.0, 1.0, 0.5]
    assert contract.phase is not None
    assert (contract.phase.period, contract.phase.stand) == (0.5, "zero")
    assert contract.command is not None
    assert contract.command.slew == (1.0, 1.0, 1.0)
    assert contract.action.feedback == "clipped"
    assert any("every 0.002 s through a low pass" in note for note in contract.notes)
    assert load_policy(path.parent, robot=robot()).path == contract.path  # the only one there
    again = load_policy(import_policy(path, tmp_path / "out", robot=robot()).path)
    assert (again.joints, again.phase, again.command) == (
        contract.joints, contract.phase, contract.command,
    )  # fmt: skip


def test_the_observation_is_that_of_its_program(tmp_path: Path) -> None:
    """Beside a loop written after deploy/utils/policy.py."""
    path, weight = write(tmp_path)
    contract, machine = load_policy(path, robot=robot()), robot()
    states = States({**standard_states(JOINTS), **policy_states(contract, JOINTS)})
    policy = Policy(contract, states, machine)
    states.joint_pos, states.joint_vel = [0.3, 0.4, 0.5, 0.6], [1.0, 2.0, 3.0, 4.0]
    states.projected_gravity, states.base_ang_vel = [0.1, 0.0, -0.9], [0.1, 0.2, 0.3]
    smoothed, last = np.zeros(3), np.zeros(2)
    for tick in range(6):
        wanted = np.array([0.05, 0.0, -0.3]) if tick > 1 else np.zeros(3)
        states.velocity_command = wanted
        smoothed = smoothed + np.clip(wanted - smoothed, -0.02, 0.02)
        phase, on = 2 * np.pi * 2.0 * 0.02 * (tick + 1), np.linalg.norm(smoothed) >= 1e-5
        seen = np.concatenate(
            (
                [0.1, 0.0, -0.9],
                np.array([0.1, 0.2, 0.3]) * 0.5,
                smoothed * [1.0, 1.0, 0.5],
                [np.cos(phase) * on, np.sin(phase) * on],
                np.array([0.5, 0.6]) - [0.4, -0.25],
                np.array([3.0, 4.0]) * 0.1,
                last,
            )
        )
        policy()
        np.testing.assert_allclose(states.observation, seen, atol=2e-6)
        last = np.clip(seen @ weight, -1.0, 1.0)
        np.testing.assert_allclose(
            states.joint_pos_target, [0.2, -1.3, 0.4 + last[0], -0.25 + last[1]], atol=2e-6
        )


@pytest.mark.parametrize(
    ("where", "value", "message"),
    [
        (
            "common.stiffness",
            [20.0],
            "stiffness has 1 values for the 4 of common.default_qpos; give 4",
        ),
        (
            "common.damping",
            [float("nan"), 1.0, 1.0, 1.0],
            "common.damping.0 is nan; write a number",
        ),
        (
            "common.default_qpos",
            [0.0] * 3,
            "stiffness has 4 values for the 3 of common.default_qpos; give 3",
        ),
        ("policy.num_actions", 5, "policy.num_actions is 5; write a whole number from 1 to 4"),
        ("policy.num_observations", 47, "what deploy/utils/policy.py lays out for 2 actions has"),
        ("policy.gait_frequency", 0, "policy.gait_frequency is 0; write a number above 0 [Hz]"),
        ("policy.control.decimation", -10, "decimation is -10; write a whole number from 1"),
        ("policy.normalization.dof_vel", None, "has no 'policy.normalization.dof_vel'; add it"),
        ("policy.policy_path", "./models/other.pt", "policy_path names other.pt, which is not"),
        ("policy.policy_path", "../../../toy.onnx", "policy_path names toy.onnx, which is not"),
    ],
)
def test_mistakes_get_one_line(tmp_path: Path, where: str, value: Any, message: str) -> None:
    values = document()
    *keys, last = where.split(".")
    place = values
    for key in keys:
        place = place[key]
    place[last] = value
    path, _ = write(tmp_path, values)
    write_linear(tmp_path / "toy.onnx", 17, 2)
    with pytest.raises(PolicyError) as caught:
        load_policy(path, robot=robot())
    assert message in str(caught.value)
    assert str(caught.value).startswith(f"{path}")
    assert "\n" not in str(caught.value)


def test_another_robot_is_refused_and_none_asks_for_the_joints(tmp_path: Path) -> None:
    path, _ = write(tmp_path)
    with pytest.raises(PolicyError, match="has 4 joints, and robot 'toy' has 2 motors; choose"):
        load_policy(path, robot=robot(JOINTS[:2]))
    with pytest.raises(PolicyError, match="motors 0, 1, 2, 3 of the robot: name the"):
        load_policy(path)
    assert load_policy(path, given={"joints": list(JOINTS)}).joints == JOINTS
    with pytest.raises(
        PolicyError, match=r"given joints has 1 names, and it counts motors 0, 1, 2, 3; name"
    ):
        load_policy(path, given={"joints": ["a_hip"]})
