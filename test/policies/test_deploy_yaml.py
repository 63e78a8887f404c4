"""Unitree's deploy.yaml: both orders, both histories, and Python tags that are never run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from policy_helpers import robot, write_linear
from reference_observation import ConcatenateObservation

from unicon_base.errors import PolicyError
from unicon_core.policies import Policy, load_policy, policy_states
from unicon_core.states import States, standard_states

MOTORS = ("m0", "m1", "m2", "m3")
# Policy joint i is motor joint_ids_map[i]; gains count motors, everything else policy joints.
DEPLOY = """\
joint_ids_map: [2, 0, 3, 1]
step_dt: 0.02
stiffness: [100.0, 101.0, 102.0, 103.0]
damping: [1.0, 1.1, 1.2, 1.3]
default_joint_pos: [0.2, 0.0, 0.3, 0.1]
commands:
  base_velocity:
    ranges: {lin_vel_x: [-0.5, 1.0], lin_vel_y: [-0.3, 0.3], ang_vel_z: [-0.2, 0.2], heading: null}
actions:
  JointPositionAction:
    clip: null
    joint_names: [.*]
    scale: [0.25, 0.5, 0.25, 0.5]
    offset: [0.2, 0.0, 0.3, 0.1]
    joint_ids: !!python/object/apply:builtins.slice [null, null, null]
observations:
  base_ang_vel:
    params: {}
    clip: null
    scale: [0.2, 0.2, 0.2]
    history_length: 3
  joint_pos_rel:
    params:
      asset_cfg: !!python/object:isaaclab.managers.SceneEntityCfg {name: robot}
    clip: [-10.0, 10.0]
    scale: [1.0, 1.0, 1.0, 1.0]
    history_length: 3
  last_action:
    params: {}
    clip: null
    scale: null
    history_length: 3
"""


def write(tmp_path: Path, *changes: tuple[str, str], inputs: int = 33, outputs: int = 4) -> Path:
    text = DEPLOY
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "velocity" / "params" / "deploy.yaml"
    path.parent.mkdir(parents=True)
    path.write_text(text, encoding="utf-8")
    write_linear(tmp_path / "velocity" / "exported" / "policy.onnx", inputs, outputs)
    return path


def test_gains_are_brought_from_motor_order_to_policy_order(tmp_path: Path) -> None:
    contract = load_policy(write(tmp_path), robot=robot(MOTORS))
    assert contract.name == "velocity"
    assert contract.joints == ("m2", "m0", "m3", "m1")
    assert contract.stiffness.tolist() == [102.0, 100.0, 103.0, 101.0]
    np.testing.assert_allclose(contract.damping, [1.2, 1.0, 1.3, 1.1])
    np.testing.assert_allclose(contract.default_joint_pos, [0.2, 0.0, 0.3, 0.1])
    assert contract.period == 0.02
    assert contract.command_ranges["lin_vel_x"] == (-0.5, 1.0)
    assert "heading" not in contract.command_ranges
    assert contract.action.feedback == "raw"
    assert any("3 significant digits" in note for note in contract.notes)


def test_commands_reach_the_motors_by_name(tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    toy = robot(MOTORS)
    contract = load_policy(write(tmp_path), robot=toy)
    states = States({**standard_states(MOTORS), **policy_states(contract, toy.joint_names)})
    policy = Policy(contract, states, toy)
    policy()
    assert states.joint_stiffness.tolist() == [100.0, 101.0, 102.0, 103.0]  # as in the file
    action = states.action
    expected = {
        name: contract.action.offset[i] + contract.action.scale[i] * action[i]
        for i, name in enumerate(contract.joints)
    }
    np.testing.assert_allclose(states.joint_pos_target, [expected[name] for name in MOTORS])


@pytest.mark.parametrize("frame_major", [False, True])
def test_histories_follow_use_gym_history(tmp_path: Path, frame_major: bool) -> None:
    change = (
        [("observations:\n", "observations:\n  use_gym_history: true\n")] if frame_major else []
    )
    contract = load_policy(write(tmp_path, *change), robot=robot(MOTORS))
    assert contract.observation.layout == ("frame_major" if frame_major else "term_major")
    assert contract.observation.newest == "last"
    assert [term.history for term in contract.terms] == [3, 3, 3]
    twin = ConcatenateObservation(contract, MOTORS)
    frames = [
        {"base_ang_vel": np.full(3, k), "joint_pos": np.full(4, k), "action": np.full(4, k)}
        for k in (1.0, 2.0, 3.0)
    ]
    for frame in frames:
        out = twin(frame)
    assert out[-1] == 3.0
    assert out[3] == pytest.approx(0.8 if frame_major else 0.4)  # joint 0 of frame 1, or gyro of 2


def test_python_tags_are_read_and_never_run(tmp_path: Path) -> None:
    marker = tmp_path / "executed"
    tag = f"!!python/object/apply:os.system ['touch {marker}']"
    path = write(tmp_path, ("!!python/object/apply:builtins.slice [null, null, null]", tag))
    load_policy(path, robot=robot(MOTORS))
    assert not marker.exists()


def test_scale_first_moves_the_clip(tmp_path: Path) -> None:
    change = ("observations:\n", "observations:\n  scale_first: true\n")
    scale = ("scale: [1.0, 1.0, 1.0, 1.0]", "scale: [2.0, 4.0, 5.0, -10.0]")
    contract = load_policy(write(tmp_path, change, scale), robot=robot(MOTORS))
    clip = contract.terms[1].clip
    assert clip is not None
    np.testing.assert_allclose(clip, [[-5.0, -2.5, -2.0, -1.0], [5.0, 2.5, 2.0, 1.0]])
    x = np.linspace(-9, 9, 50)[:, None]
    scale_values = contract.terms[1].scale
    np.testing.assert_allclose(
        scale_values * np.clip(x, *clip), np.clip(x * scale_values, -10, 10), rtol=1e-6
    )


def test_a_clip_of_the_target_becomes_a_clip_of_the_action(tmp_path: Path) -> None:
    change = ("    clip: null\n    joint_names", "    clip: [[-1, 1], [0, 1], [-1, 1], [0, 1]]\n    joint_names")  # fmt: skip  # noqa: E501
    contract = load_policy(write(tmp_path, change), robot=robot(MOTORS))
    clip = contract.action.clip
    assert clip is not None
    target = contract.action.offset + contract.action.scale * clip
    np.testing.assert_allclose(target, [[-1, 0, -1, 0], [1, 1, 1, 1]], atol=1e-6)


def test_actions_may_move_a_part_of_the_joints(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        ("!!python/object/apply:builtins.slice [null, null, null]", "[0, 2]"),
        ("scale: [0.25, 0.5, 0.25, 0.5]", "scale: [0.25, 0.5]"),
        ("offset: [0.2, 0.0, 0.3, 0.1]", "offset: [0.2, 0.3]"),
        outputs=2,
    )
    contract = load_policy(path, robot=robot(MOTORS))
    assert contract.action.joints == ("m2", "m3")
    assert len(contract.joints) == 4


def test_a_gait_phase_brings_its_clock(tmp_path: Path) -> None:
    term = "  gait_phase:\n    params: {period: 0.8}\n    scale: null\n    clip: null\n"
    contract = load_policy(
        write(tmp_path, ("  last_action:\n", f"{term}  last_action:\n")), robot=robot(MOTORS)
    )
    assert contract.phase is not None
    assert contract.phase.period == 0.8
    assert contract.phase.offsets == (0.0,)
    assert contract.phase.stand is None
    assert contract.terms[2].state == "gait_phase"


def test_joint_pos_is_absolute_and_joint_pos_rel_relative(tmp_path: Path) -> None:
    contract = load_policy(
        write(tmp_path, ("  joint_pos_rel:", "  joint_pos:")), robot=robot(MOTORS)
    )
    assert contract.terms[1].subtract is None


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "[2, 0, 3, 1]",
            "[2, 0, 4, 1]",
            ":1: joint_ids_map names motor 4, but robot 'toy' has 4 motors up to number 3; choose "
            "the robot whose motors it counts",
        ),
        (
            "[2, 0, 3, 1]",
            "[2, 0, 2, 1]",
            ":1: joint_ids_map names 2 twice; name each once",
        ),
        (
            "default_joint_pos: [0.2, 0.0, 0.3, 0.1]",
            "default_joint_pos: [0.2]",
            ":5: default_joint_pos has 1 values for the 4 of joint_ids_map; give 4",
        ),
        (
            "  JointPositionAction:",
            "  JointVelocityAction:",
            ":9: actions are JointVelocityAction; only one JointPositionAction (joint position "
            "targets) runs",
        ),
        (
            "scale: [0.25, 0.5, 0.25, 0.5]",
            "scale: [0.25, 0.5]",
            ":13: scale has 2 values; give 4",
        ),
        (
            DEPLOY[DEPLOY.index("  base_ang_vel:") :],
            "  policy: 3\n",
            ":17: observations.policy is 3; write a mapping of terms",
        ),
        (
            "clip: null\n    joint_names: [.*]\n    scale: [0.25,",
            "clip: [[-1, 1]]\n    joint_names: [.*]\n    scale: [0.0,",
            ":11: clip is [[-1, 1]]; give [lowest, highest] each",
        ),
        (
            DEPLOY[DEPLOY.index("  base_ang_vel:") :],
            "  policy: {a: {scale: 1.0}}\n  critic: {a: {scale: 1.0}}\n",
            ":16: observations has the groups policy, critic; only one can be imported, write a "
            "policy.yaml with 'inputs' for the others",
        ),
        (
            "step_dt: 0.02",
            "step_dt: 0.02\nstep_dt: 0.01",
            ":3: not valid YAML: key 'step_dt' stands twice, first in line 2; remove one",
        ),
    ],
)
def test_a_wrong_file_gets_one_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = write(tmp_path, (old, new))
    with pytest.raises(PolicyError) as caught:
        load_policy(path, robot=robot(MOTORS))
    assert str(caught.value) == f"{path}{message}"


def test_gains_that_do_not_reach_every_motor_are_asked_for(tmp_path: Path) -> None:
    """As in unitree_rl_lab's file for the G1 with 23 joints: 23 gains, and motors up to 26."""
    path = write(tmp_path, ("[2, 0, 3, 1]", "[2, 0, 6, 1]"))
    gapped = replace(robot(MOTORS), transport={"motors": [0, 1, 2, 6]})
    with pytest.raises(PolicyError) as caught:
        load_policy(path, robot=gapped)
    assert str(caught.value) == (
        f"{path}: the deploy.yaml does not say stiffness (in [N·m/rad], policy order; the file has "
        "4 values in motor order, but joint_ids_map names motor 6); damping (in [N·m·s/rad], "
        "policy order; the file has 4 values in motor order, but joint_ids_map names motor 6); "
        "give it under 'given' in the workflow, with the keys of policy.yaml"
    )
    given = {"stiffness": [102.0, 100.0, 103.0, 101.0], "damping": 1.0}
    contract = load_policy(path, robot=gapped, given=given)
    assert contract.joints == ("m2", "m0", "m3", "m1")
    assert contract.stiffness.tolist() == [102.0, 100.0, 103.0, 101.0]


def test_without_a_robot_the_joints_are_asked_for(tmp_path: Path) -> None:
    path = write(tmp_path)
    with pytest.raises(PolicyError) as caught:
        load_policy(path)
    assert str(caught.value) == (
        f"{path}: the deploy.yaml does not say joints (the joint names in policy order; motors "
        "2, 0, 3, 1 of the robot: name the robot); give it "
        "under 'given' in the workflow, with the keys of policy.yaml"
    )
    contract = load_policy(path, given={"joints": ["m2", "m0", "m3", "m1"]})
    assert contract.stiffness.tolist() == [102.0, 100.0, 103.0, 101.0]


def test_an_unknown_term_asks_for_its_state(tmp_path: Path) -> None:
    path = write(tmp_path, ("  base_ang_vel:", "  foot_contacts:"))
    with pytest.raises(PolicyError, match=r"observation\.terms\.foot_contacts\.state"):
        load_policy(path, robot=robot(MOTORS))
    contract = load_policy(
        path,
        robot=robot(MOTORS),
        given={"observation": {"terms": {"foot_contacts": {"state": "base_lin_vel"}}}},
    )
    assert contract.terms[0].state == "base_lin_vel"


def test_a_height_scan_asks_for_its_grid(tmp_path: Path) -> None:
    path = write(tmp_path, ("  base_ang_vel:", "  height_scan:"))
    with pytest.raises(PolicyError, match=r"height_scan \(size and resolution of its grid in"):
        load_policy(path, robot=robot(MOTORS))
    grid = {"size": [0.2, 0.0], "resolution": 0.1}
    assert load_policy(path, robot=robot(MOTORS), given={"height_scan": grid}).height_scan


def test_the_asset_is_read_in_full(assets: Path) -> None:
    from unicon_core.robots import load_robot

    contract = load_policy(assets / "policies" / "g1_velocity_mjlab", robot=load_robot("g1_29dof"))
    assert len(contract.joints) == 29
    assert contract.period == 0.02
    assert sum({"action": 29, "joint_pos": 29, "joint_vel": 29}.get(t.state, 3)
               for t in contract.terms) == 96  # fmt: skip
    assert contract.stiffness[:4] == pytest.approx([40.2, 99.1, 40.2, 99.1])
    assert dict(contract.inputs) == {"observation": "obs"}
    assert dict(contract.outputs) == {"action": "actions"}
