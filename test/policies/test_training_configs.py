"""Isaac Lab's env.yaml and legged_gym's configuration, as far as they say what a policy needs."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from policy_helpers import JOINTS, robot, write_linear

from unicon_base.errors import PolicyError
from unicon_core.policies import import_policy, load_policy

EVIDENCE = "stand_in"
"""What these tests run against, the most that config/evidence.yaml may say by them."""

ENV = """\
viewer:
  eye: !!python/tuple [7.5, 7.5, 7.5]
sim: {dt: 0.005, device: 'cuda:0'}
decimation: 4
scene:
  robot:
    class_type: isaaclab.assets.articulation.articulation:Articulation
    init_state:
      joint_pos:
        .*_hip: 0.1
        .*_knee: -1.5
    actuators:
      legs:
        joint_names_expr: [.*_hip, a_knee]
        stiffness: 25.0
        damping: {.*_hip: 0.5, .*_knee: 0.8}
      rest:
        joint_names_expr: ['b_k.*']
        stiffness: {b_knee: 35.0}
        damping: 0.9
observations:
  policy:
    concatenate_terms: true
    history_length: null
    flatten_history_dim: true
    base_ang_vel:
      func: isaaclab.envs.mdp.observations:base_ang_vel
      params: {}
      clip: !!python/tuple [-100.0, 100.0]
      scale: 0.2
      history_length: 3
    projected_gravity:
      func: isaaclab.envs.mdp.observations:projected_gravity
      scale: null
      clip: null
      history_length: 0
    velocity_commands:
      func: isaaclab.envs.mdp.observations:generated_commands
      params: {command_name: base_velocity}
    joint_angles:
      func: isaaclab.envs.mdp.observations:joint_pos_rel
      params:
        asset_cfg:
          joint_ids: !!python/object/apply:builtins.slice [null, null, null]
    joint_vel:
      func: isaaclab.envs.mdp.observations:joint_vel_rel
      scale: 0.05
    actions:
      func: isaaclab.envs.mdp.observations:last_action
actions:
  joint_pos:
    class_type: isaaclab.envs.mdp.actions.joint_actions:JointPositionAction
    joint_names: ['.*']
    scale: {.*_hip: 0.125, '^(?!.*_hip).*': 0.25}
    offset: 0.0
    use_default_offset: true
commands:
  base_velocity:
    ranges:
      lin_vel_x: !!python/tuple [-1.0, 1.0]
      heading: null
"""

GYM = """\
init_state:
  default_joint_angles: {a_hip: 0.1, a_knee: -1.5, b_hip: 0.1, b_knee: -1.5}
control:
  stiffness: {hip: 20.0, knee: 30.0}
  damping: {hip: 0.5, knee: 0.6}
  action_scale: 0.25
  decimation: 4
sim: {dt: 0.005}
normalization:
  obs_scales: {ang_vel: 0.25, dof_vel: 0.05}
  clip_actions: 100.0
commands:
  ranges: {lin_vel_x: [-1.0, 1.0], ang_vel_yaw: [-2.0, 2.0]}
"""


def write(tmp_path: Path, text: str, *changes: tuple[str, str]) -> Path:
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "run" / "params" / "env.yaml"
    path.parent.mkdir(parents=True)
    path.write_text(text, "utf-8")
    write_linear(tmp_path / "run" / "exported" / "policy.onnx", 27, 4)
    return path


def test_isaac_lab_patterns_are_resolved_once_the_joints_are_given(tmp_path: Path) -> None:
    path = write(tmp_path, ENV)
    with pytest.raises(PolicyError) as caught:
        load_policy(path)
    text = str(caught.value)
    assert text.startswith(
        f"{path}: the Isaac Lab env.yaml does not say joints (the joint names in policy order); "
    )
    contract = load_policy(path, given={"joints": list(JOINTS)})
    assert contract.name == "run"
    assert contract.period == pytest.approx(0.02)
    assert contract.default_joint_pos == pytest.approx([0.1, -1.5, 0.1, -1.5])
    assert contract.stiffness.tolist() == [25.0, 25.0, 25.0, 35.0]
    assert contract.damping == pytest.approx([0.5, 0.8, 0.5, 0.9])
    assert contract.action.scale.tolist() == [0.125, 0.25, 0.125, 0.25]
    assert contract.action.offset == pytest.approx([0.1, -1.5, 0.1, -1.5])
    assert [(t.name, t.state, t.history) for t in contract.terms] == [
        ("base_ang_vel", "base_ang_vel", 3),
        ("projected_gravity", "projected_gravity", 1),
        ("velocity_commands", "velocity_command", 1),
        ("joint_angles", "joint_pos", 1),
        ("joint_vel", "joint_vel", 1),
        ("actions", "action", 1),
    ]
    assert contract.terms[3].subtract == "default_joint_pos"
    assert contract.terms[0].clip is not None
    assert contract.command_ranges == {"lin_vel_x": (-1.0, 1.0)}


def chosen(names: str, kept: bool, ids: str = "'slice(None, None, None)'") -> str:
    order = str(kept).lower()
    return f"{{name: robot, joint_names: {names}, preserve_order: {order}, joint_ids: {ids}}}"


SLICE = """\
          joint_ids: !!python/object/apply:builtins.slice [null, null, null]
"""
STATED = "[b_hip, b_knee, a_hip, a_knee]"
VEL = "joint_vel_rel\n"
ANGLES = f"        asset_cfg:\n{SLICE}"


def stated(names: str, kept: bool) -> list[tuple[str, str]]:
    """The action and the terms of joints name them."""
    own = chosen(names, kept)
    return [
        ("joint_names: ['.*']", f"joint_names: {names}\n    preserve_order: {str(kept).lower()}"),
        (ANGLES, f"        asset_cfg: {own}\n"),
        (VEL, f"{VEL}      params: {{asset_cfg: {own}}}\n"),
    ]


def test_isaac_joints_named_one_by_one_in_an_order_that_is_kept_are_the_joints(
    tmp_path: Path,
) -> None:
    path = write(tmp_path, ENV, *stated(STATED, True))
    contract = load_policy(path)
    names = ("b_hip", "b_knee", "a_hip", "a_knee")
    assert contract.joints == contract.action.joints == names
    assert contract.stiffness.tolist() == [25.0, 35.0, 25.0, 25.0]
    assert contract.action.scale.tolist() == [0.125, 0.25, 0.125, 0.25]
    assert all(term.index is None for term in contract.terms)
    # Whatever order is given, the network's stays.
    again = load_policy(path, given={"joints": list(JOINTS)})
    assert again.joints == JOINTS
    assert again.action.joints == names
    assert [t.index for t in again.terms] == [None, None, None, (2, 3, 0, 1), (2, 3, 0, 1), None]


def test_isaac_joints_whose_order_is_not_kept_are_in_that_of_the_articulation(
    tmp_path: Path,
) -> None:
    path = write(tmp_path, ENV, *stated(STATED, False))
    with pytest.raises(PolicyError, match=r"does not say joints \(the joint names in policy order"):
        load_policy(path)
    contract = load_policy(path, given={"joints": list(JOINTS)})
    assert contract.action.joints == JOINTS
    assert all(term.index is None for term in contract.terms)


def test_a_term_without_an_order_of_its_own_asks_for_that_of_the_articulation(
    tmp_path: Path,
) -> None:
    path = write(tmp_path, ENV, *stated(STATED, True)[:2])
    with pytest.raises(PolicyError) as caught:
        load_policy(path)
    assert (
        "does not say joints (the joint names in policy order; term 'joint_vel' has them in the "
        "articulation's order); give it"
    ) in str(caught.value)
    contract = load_policy(path, given={"joints": list(JOINTS)})
    assert [term.index for term in contract.terms[3:5]] == [(2, 3, 0, 1), None]


@pytest.mark.parametrize(
    ("asset", "index"),
    [
        (chosen("['.*_knee', a_hip]", False), (0, 1, 3)),
        (chosen("['.*_knee', a_hip]", True), (1, 3, 0)),
        (chosen("'.*_hip'", False, "[0, 2]"), (0, 2)),
        (chosen("null", False, "[3, 0]"), (3, 0)),
    ],
)
def test_an_isaac_term_sees_the_joints_that_it_names(
    tmp_path: Path, asset: str, index: tuple[int, ...]
) -> None:
    path = write(tmp_path, ENV, (ANGLES, f"        asset_cfg: {asset}\n"))
    contract = load_policy(path, given={"joints": list(JOINTS)})
    assert [term.index for term in contract.terms[3:5]] == [index, None]


def test_an_isaac_name_that_is_no_joint_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path, ENV, (ANGLES, f"        asset_cfg: {chosen('[a_hip, c_hip]', True)}\n"))
    with pytest.raises(PolicyError) as caught:
        load_policy(path, given={"joints": list(JOINTS)})
    assert str(caught.value) == (
        f"{path}:40: 'joint_angles': joint_names has 'c_hip', which is none of the joints; did you "
        "mean 'b_hip'? known: a_hip, a_knee, b_hip, b_knee"
    )


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            (VEL, f"{VEL}      modifiers: [{{func: 'isaaclab.utils.modifiers:scale'}}]\n"),
            "joint_vel.state (env.yaml gives it modifiers (isaaclab.utils.modifiers:scale), ",
        ),
        ((VEL, f"{VEL}      params: {{asset_cfg: {{name: arm}}}}\n"), "params.asset_cfg (arm), "),
        (
            (VEL, f"{VEL}      params: {{lag: 3}}\n"),
            "joint_vel.state (env.yaml gives it params.lag",
        ),
        (("command_name: base_velocity", "command_name: pose"), "it params.command_name (pose), "),
    ],
)
def test_what_changes_an_isaac_term_and_is_not_read_must_be_given(
    tmp_path: Path, change: tuple[str, str], said: str
) -> None:
    path, given = write(tmp_path, ENV, change), {"joints": list(JOINTS)}
    with pytest.raises(PolicyError) as caught:
        load_policy(path, given=given)
    assert said in str(caught.value)
    assert "which is not read: give its state, index, subtract, scale and clip" in str(caught.value)
    name = "joint_vel" if change[0] == VEL else "velocity_commands"
    terms = {name: {"state": "joint_vel", "scale": 0.1}}
    contract = load_policy(path, given=given | {"observation.terms": terms})
    (term,) = (term for term in contract.terms if term.name == name)
    assert term.scale == pytest.approx(0.1)


def test_isaac_counts_the_joints_of_a_model_breadth_first(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    model = tmp_path / "robot.xml"
    legs = "".join(
        f"<body><geom size='0.1'/><joint name='{leg}_hip'/>"
        f"<body><geom size='0.1'/><joint name='{leg}_knee'/></body></body>"
        for leg in "ab"
    )
    model.write_text(f"<mujoco><worldbody><body><freejoint/><geom size='0.1'/>{legs}</body>"
                     "</worldbody></mujoco>", "utf-8")  # fmt: skip
    path, made = write(tmp_path, ENV), robot()
    machine = type(made)(
        **{**vars(made), "models": {"mjcf": "robot.xml"}, "path": tmp_path / "toy.yaml"}
    )
    with pytest.raises(PolicyError) as caught:
        load_policy(path, robot=machine)
    assert str(caught.value).endswith(
        "; model robot.xml can say some of it: given: {joints: {from: model}}"
    )
    contract = load_policy(path, robot=machine, given={"joints": {"from": "model"}})
    assert contract.joints == ("a_hip", "b_hip", "a_knee", "b_knee")
    assert contract.stiffness.tolist() == [25.0, 25.0, 25.0, 35.0]
    given = {"joints": {"from": "model", "order": "depth_first"}}
    assert load_policy(path, robot=machine, given=given).joints == JOINTS


ARM = [*JOINTS[:2], "arm", *JOINTS[2:]]


def test_joints_that_no_actuator_matches_are_named(tmp_path: Path) -> None:
    path = write(tmp_path, ENV)
    with pytest.raises(PolicyError) as caught:
        load_policy(path, given={"joints": ARM})
    assert (
        "does not say stiffness (in [N·m/rad], policy order; no actuator's joint_names_expr "
        "matches arm; the network's output is as wide as the 4 others: if they are all that it was "
        "trained with, give joints without these: --joints a_hip,a_knee,b_hip,b_knee); damping (in "
        "[N·m·s/rad], policy order; no actuator's joint_names_expr matches arm); give it under "
    ) in str(caught.value)
    write_linear(tmp_path / "run" / "exported" / "policy.onnx", 27, 5)
    with pytest.raises(
        PolicyError, match=r"\(in \[N·m/rad\], policy order; no [^;]+ arm\); damping"
    ):
        load_policy(path, given={"joints": ARM})


def test_gains_of_some_joints_stay_in_what_an_import_writes(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    drives = "".join(f'<position joint="{joint}" kp="500" kv="40"/>' for joint in ARM)
    bodies = "".join(f"<body><geom size='0.1'/><joint name='{joint}'/></body>" for joint in ARM)
    (tmp_path / "robot.xml").write_text(
        f"<mujoco><worldbody><body><freejoint/><geom size='0.1'/>{bodies}</body></worldbody>"
        f"<actuator>{drives}</actuator></mujoco>",
        "utf-8",
    )
    made = robot(ARM)
    machine = type(made)(
        **{**vars(made), "models": {"mjcf": "robot.xml"}, "path": tmp_path / "toy.yaml"}
    )
    path = write(tmp_path, ENV, ("damping: 0.9", "damping: null"))
    report = import_policy(path, tmp_path / "out", robot=machine, given={"joints": ARM})
    assert list(report.missing) == ["stiffness", "damping"]
    text = report.path.read_text("utf-8")
    assert text.startswith("# env.yaml does not say, so add:\n#   stiffness: in [N·m/rad], policy ")
    values = yaml.safe_load(text)
    assert values["stiffness"] == [25.0, 25.0, "?", 25.0, 35.0]
    assert values["damping"] == [0.5, 0.8, "?", 0.5, "?"]
    with pytest.raises(PolicyError) as caught:
        load_policy(report.path, robot=machine)
    assert str(caught.value) == (
        f"{report.path}: the policy.yaml does not say stiffness (in [N·m/rad], policy order; ? "
        "stands for arm); damping (in [N·m·s/rad], policy order; ? stands for arm, b_knee); add it "
        "to policy.yaml"
    )
    model = {"from": "model"}
    for source in (path, report.path):  # gains of the model are other ones
        given = {"joints": ARM, "stiffness": model, "damping": 0.7}
        with pytest.raises(
            PolicyError, match=r"stiffness is \[25.0, 25.0, '\?', 25.0, 35.0\] and "
        ):
            load_policy(source, robot=machine, given=given)
        given = {"joints": ARM, "stiffness": [25, 25, 9, 25, 35], "damping": [0.5, 0.8, 1, 0.5, 2]}
        contract = load_policy(source, robot=machine, given=given)
        assert contract.stiffness.tolist() == [25.0, 25.0, 9.0, 25.0, 35.0]
        assert contract.damping == pytest.approx([0.5, 0.8, 1.0, 0.5, 2.0])


@pytest.mark.parametrize("kind", ["JointEffortAction", "RelativeJointPositionAction"])
def test_other_actions_than_position_targets_are_refused(tmp_path: Path, kind: str) -> None:
    path = write(tmp_path, ENV, (":JointPositionAction", f":{kind}"))
    with pytest.raises(PolicyError) as caught:
        load_policy(path)
    assert str(caught.value) == (
        f"{path}:51: action 'joint_pos' is isaaclab.envs.mdp.actions.joint_actions:"
        f"{kind}; only joint position targets can be run"
    )


def test_a_group_that_is_not_concatenated_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path, ENV, ("concatenate_terms: true", "concatenate_terms: false"))
    with pytest.raises(PolicyError) as caught:
        load_policy(path)
    assert str(caught.value) == (
        f"{path}:22: observations.policy is not concatenated; only one input vector can be run"
    )


def test_legged_gym_leaves_joints_and_terms_to_be_given(tmp_path: Path) -> None:
    path = write(tmp_path, GYM)
    with pytest.raises(PolicyError, match="the legged_gym configuration does not say joints"):
        load_policy(path)
    given = {
        "joints": list(JOINTS),
        "observation.terms": [
            {"name": "ang_vel", "state": "base_ang_vel", "scale": 0.25},
            {"name": "last_action", "state": "action"},
        ],
    }
    contract = load_policy(path, given=given)
    assert contract.period == pytest.approx(0.02)
    assert contract.stiffness.tolist() == [20.0, 30.0, 20.0, 30.0]
    assert contract.damping == pytest.approx([0.5, 0.6, 0.5, 0.6])
    assert contract.action.feedback == "clipped"
    assert contract.action.clip is not None
    assert contract.action.clip[:, 0].tolist() == [-100.0, 100.0]
    assert contract.observation.start == "zeros"
    assert contract.command_ranges["ang_vel_z"] == (-2.0, 2.0)
    assert any("ang_vel 0.25, dof_vel 0.05" in note for note in contract.notes)


def test_a_joint_without_a_pattern_leaves_its_fact_to_be_given(tmp_path: Path) -> None:
    path = write(tmp_path, GYM, ("knee: 0.6", "ankle: 0.6"))
    given = {"joints": list(JOINTS), "observation.terms": [{"name": "a", "state": "action"}]}
    with pytest.raises(PolicyError) as caught:
        load_policy(path, given=given)
    assert "does not say damping (in [N·m·s/rad], policy order); give it" in str(caught.value)


SCAN = """\
  height_scanner:
    prim_path: /World/envs/env_.*/Robot/base
    offset: {pos: !!python/tuple [0.1, 0.0, 20.0], rot: !!python/tuple [1.0, 0.0, 0.0, 0.0]}
    ray_alignment: yaw
    pattern_cfg:
      func: isaaclab.sensors.ray_caster.patterns.patterns:grid_pattern
      resolution: 0.5
      size: !!python/tuple [1.0, 0.5]
      direction: !!python/tuple [0.0, 0.0, -1.0]
      ordering: yx
"""
SCANNED = """\
    height_scan:
      func: isaaclab.envs.mdp.observations:height_scan
      params: {sensor_cfg: {name: height_scanner}}
      clip: !!python/tuple [-1.0, 1.0]
actions:
"""


def scanning(*changes: tuple[str, str]) -> list[tuple[str, str]]:
    scan = SCAN
    for old, new in changes:
        assert old in scan
        scan = scan.replace(old, new)
    return [("scene:\n", f"scene:\n{scan}"), ("actions:\n  joint_pos", f"{SCANNED}  joint_pos")]


def test_a_height_scanner_of_isaac_is_the_height_scan(tmp_path: Path) -> None:
    path = write(tmp_path, ENV, *scanning())
    contract = load_policy(path, given={"joints": list(JOINTS)})
    scan, term = contract.height_scan, contract.terms[-1]
    assert scan is not None
    assert (scan.size, scan.resolution, scan.offset) == ((1.0, 0.5), 0.5, (0.1, 0.0))
    assert (scan.order, scan.counts) == ("yx", (3, 2))
    assert (term.state, term.subtract.tolist()) == ("height_scan", [0.5])  # type: ignore[union-attr]
    assert any("height_scanner hangs on base" in note for note in contract.notes)


@pytest.mark.parametrize(
    "change",
    [
        ("ray_alignment: yaw", "ray_alignment: base"),
        ("patterns:grid_pattern", "patterns:lidar_pattern"),
        ("[0.0, 0.0, -1.0]", "[0.0, 1.0, -1.0]"),
        ("height_scanner:", "other:"),
    ],
)
def test_another_scanner_of_isaac_must_be_given(tmp_path: Path, change: tuple[str, str]) -> None:
    path = write(tmp_path, ENV, *scanning(change))
    with pytest.raises(PolicyError, match=r"height_scan.state .*params.sensor_cfg \(height_sc"):
        load_policy(path, given={"joints": list(JOINTS)})
