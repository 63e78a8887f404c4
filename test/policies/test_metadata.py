"""ONNX metadata of BeyondMimic, mjlab, holosoma and exploy: what they say, and what they do not."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from policy_helpers import JOINTS, robot, write_graph, write_linear, write_toy

from unicon_base.errors import PolicyError
from unicon_base.schema.types import show
from unicon_core.policies import Policy, import_policy, load_policy, policy_states
from unicon_core.states import States, standard_states

OLD = {
    "run_path": "run-7",
    "joint_names": "a_hip,a_knee,b_hip,b_knee",
    "joint_stiffness": "40.179,99.098,40.179,99.098",
    "joint_damping": "2.558,6.309,2.558,6.309",
    "default_joint_pos": "-0.312,0.669,-0.312,0.669",
    "command_names": "twist",
    "observation_names": "base_ang_vel,projected_gravity,joint_pos,joint_vel,actions,command",
    "action_scale": "0.5",
}
NEW = {
    **OLD,
    "observation_terms_scale": "0.250,1.000,1.000,0.050,1.000,2.000;2.000;0.250",
    "observation_terms_clip": "-inf;inf,-inf;inf,-3.000;3.000,None,-100.000;100.000,-inf;inf",
    "observation_terms_history_length": "5.000,5.000,5.000,5.000,5.000,0.000",
    "observation_terms_flatten_history_dim": "1.000,1.000,1.000,1.000,1.000,1.000",
}

HEAD = "actions = Slice(obs, zero, four, one)"
SLICE: dict[str, Any] = {"zero": [0], "four": [4], "one": [1]}


def write(tmp_path: Path, metadata: dict[str, str], inputs: int = 21, **options: Any) -> Path:
    path = tmp_path / "walk.onnx"
    write_linear(path, inputs, 4, metadata=list(metadata.items()), **options)
    return path


def test_old_mjlab_keys_leave_period_and_scales_to_be_given(tmp_path: Path) -> None:
    path = write(tmp_path, OLD)
    with pytest.raises(PolicyError) as caught:
        load_policy(path)
    assert str(caught.value) == (
        f"{path}: the mjlab metadata does not say period (the control period in [s]); "
        "observation.scale (scale of each term, or under 'given' one factor for all); give it "
        "under 'given' in the workflow, with the keys of policy.yaml"
    )
    contract = load_policy(path, given={"period": 0.02, "observation.scale": 1.0})
    assert contract.name == "walk"
    assert contract.joints == JOINTS
    assert contract.action.scale.tolist() == [0.5] * 4
    np.testing.assert_array_equal(contract.action.offset, contract.default_joint_pos)
    assert [(t.name, t.state) for t in contract.terms] == [
        ("base_ang_vel", "base_ang_vel"),
        ("projected_gravity", "projected_gravity"),
        ("joint_pos", "joint_pos"),
        ("joint_vel", "joint_vel"),
        ("actions", "action"),
        ("command", "velocity_command"),
    ]
    assert contract.terms[2].subtract == "default_joint_pos"
    assert any("rounded to 3 decimals" in note for note in contract.notes)


def test_scales_may_be_given_term_by_term(tmp_path: Path) -> None:
    names = OLD["observation_names"].split(",")
    terms = {name: {"scale": 1.0} for name in names}
    terms["base_ang_vel"]["scale"] = 0.25
    given: dict[str, Any] = {"period": 0.02, "observation": {"terms": terms}}
    contract = load_policy(write(tmp_path, OLD), given=given)
    assert contract.terms[0].scale.tolist() == [0.25]
    del terms["actions"]
    with pytest.raises(PolicyError, match=r"does not say observation\.scale"):
        load_policy(tmp_path / "walk.onnx", given=given)


def test_new_mjlab_keys_say_scales_clips_and_histories(tmp_path: Path) -> None:
    contract = load_policy(write(tmp_path, NEW, 93), given={"period": 0.02})
    assert [term.history for term in contract.terms] == [5, 5, 5, 5, 5, 1]
    assert contract.terms[0].scale.tolist() == [0.25]
    assert contract.terms[5].scale.tolist() == [2.0, 2.0, 0.25]
    assert contract.terms[0].clip is None
    assert contract.terms[2].clip is not None
    assert contract.terms[2].clip.tolist() == [[-3.0], [3.0]]
    assert contract.terms[3].clip is None
    assert contract.observation.layout == "term_major"
    states = States({**standard_states(JOINTS), **policy_states(contract, robot().joint_names)})
    assert states.observation.size == 93


def test_beyondmimic_names_its_motion_inputs_and_its_anchor(tmp_path: Path) -> None:
    metadata = {
        **OLD,
        "command_names": "motion",
        "observation_names": "command,motion_anchor_ori_b,base_ang_vel,joint_pos,joint_vel,actions",
        "observation_history_lengths": "1.000,1.000,1.000,1.000,1.000,1.000",
        "anchor_body_name": "torso_link",
        "body_names": "pelvis,torso_link",
    }
    path = tmp_path / "dance.onnx"
    write_graph(
        path,
        f"{HEAD}\njoint_pos = Add(time_step, time_step)",
        ["obs", "time_step"],
        {"obs": [1, 29], "time_step": [1, 1], "actions": [1, 4], "joint_pos": [1, 1]},
        SLICE,
        list(metadata.items()),
    )
    with pytest.raises(PolicyError, match=r"does not say period .*; observation\.scale"):
        load_policy(path)
    contract = load_policy(path, given={"period": 0.02, "observation.scale": 1.0})
    assert contract.source == "BeyondMimic metadata"
    assert contract.terms[0].state == "motion_command"
    assert contract.terms[1].state == "motion_anchor_ori_b"
    assert contract.motion is None  # the network tells no joint velocities to follow
    assert dict(contract.inputs) == {"observation": "obs", "time_step": "time_step"}
    assert dict(contract.outputs) == {"action": "actions", "motion_joint_pos": "joint_pos"}


def test_a_motion_policy_reads_the_reference_of_the_step_before(tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    path = tmp_path / "dance.onnx"
    metadata = {
        **OLD, "command_names": "motion", "observation_names": "command,actions",
        "anchor_body_name": "torso_link", "body_names": "pelvis,torso_link",
    }  # fmt: skip
    write_graph(
        path,
        f"""{HEAD}
        joint_pos = Add(time_step, tens)
        joint_vel = Mul(time_step, tens)
        body_pos_w = Add(time_step, body)""",
        ["obs", "time_step"],
        {
            "obs": [1, 12], "time_step": [1, 1], "actions": [1, 4], "joint_pos": [1, 4],
            "joint_vel": [1, 4], "body_pos_w": [1, 2, 3],
        },
        SLICE | {"tens": [[10.0, 20.0, 30.0, 40.0]], "body": [[[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]]},
        list(metadata.items()),
    )  # fmt: skip
    contract = load_policy(path, given={"period": 0.02, "observation.scale": 1.0})
    states = States({**standard_states(JOINTS), **policy_states(contract, robot().joint_names)})
    policy = Policy(contract, states, robot())
    assert "motion_command" in policy.writes
    assert "motion_command" not in policy.reads
    for _ in range(2):
        for step in range(3):
            policy.warm_up()
            policy()
            # The observation has the reference of the step before, the states that of this one.
            reference = [10.0 + step, 20.0 + step, 30.0 + step, 40.0 + step]
            assert states.observation[:4].tolist() == reference
            assert states.observation[4:8].tolist() == [10.0 * step * k for k in (1, 2, 3, 4)]
            assert states.action.tolist() == reference
            assert states.motion_body_pos_w.tolist() == [step + 1.0 + k for k in range(6)]
        policy.reset()


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("joint_damping", "1.0,2.0", "joint_damping has 2 values for 4 joint_names"),
        ("joint_damping", "1,2,x,4", "joint_damping has 'x' where a number belongs"),
        ("action_scale", "0.5,0.5", "action_scale has 2 values for 4 joint_names"),
        (
            "observation_terms_scale",
            "1.0,1.0",
            "observation_terms_scale has 2 entries for 6 observation_names",
        ),
        (
            "observation_terms_history_length",
            "1.5,1,1,1,1,1",
            "observation_terms_history_length has 1.5; give whole numbers",
        ),
        (
            "observation_terms_flatten_history_dim",
            "0.000,1.000,1.000,1.000,1.000,1.000",
            "observation_terms_flatten_history_dim is off for 'base_ang_vel' with history 5; only "
            "flattened histories can be run",
        ),
        (
            "observation_terms_clip",
            "1;2;3,-inf;inf,-inf;inf,-inf;inf,-inf;inf,-inf;inf",
            "observation_terms_clip has [1.0, 2.0, 3.0]; give lowest;highest",
        ),
    ],
)
def test_metadata_against_the_format_get_one_line(
    tmp_path: Path, key: str, value: str, message: str
) -> None:
    path = write(tmp_path, {**NEW, key: value})
    with pytest.raises(PolicyError) as caught:
        load_policy(path)
    assert str(caught.value) == f"{path}: metadata {message}; export the policy again"


def test_a_key_twice_is_refused_while_importing(tmp_path: Path) -> None:
    path = tmp_path / "walk.onnx"
    metadata = [*OLD.items(), ("observation_names", "joint_pos,joint_vel")]
    write_linear(path, 21, 4, metadata=metadata)
    with pytest.raises(PolicyError, match="metadata key 'observation_names' stands twice, as "):
        load_policy(path, given={"period": 0.02})


TWICE = {
    "joint_names": "b_hip,a_hip,b_knee,a_knee",
    "joint_stiffness": "1.0,2.0,3.0,4.0",
    "action_scale": "0.125",
    "observation_names": "joint_pos,joint_vel",
    "observation_terms_scale": "1.0,1.0,1.0,1.0,1.0,1.0",
    "observation_terms_history_length": "4.0,4.0,4.0,4.0,4.0,4.0",
}
NAMES = OLD["observation_names"].split(",")


@pytest.mark.parametrize("key", TWICE)
def test_given_settles_a_key_that_stands_twice(tmp_path: Path, key: str) -> None:
    path, joints = tmp_path / "walk.onnx", ["a_knee", "a_hip", "b_knee", "b_hip"]
    terms = [{"name": "joint_pos", "state": "joint_pos", "scale": 3.0}]
    said: dict[str, Any] = {
        "joint_names": {"joints": joints},
        "joint_stiffness": {"stiffness": [9.0, 8.0, 7.0, 6.0]},
        "action_scale": {"action": {"scale": 0.5}},
        "observation_names": {"observation.terms": terms},
        "observation_terms_scale": {"observation": {"scale": 3.0}},
        "observation_terms_history_length": {
            "observation.terms": {name: {"history": 2} for name in NAMES}
        },
    }
    metadata = {**NEW, "observation_terms_history_length": ",".join(["0"] * 6)}
    inputs = 4 if key == "observation_names" else 21
    write_linear(path, inputs, 4, metadata=[*metadata.items(), (key, TWICE[key])])
    with pytest.raises(PolicyError) as caught:
        load_policy(path, given={"period": 0.02})
    assert f"{path}: metadata key {key!r} stands twice, as " in str(caught.value)
    assert "one of them, or say " in str(caught.value)
    with pytest.raises(PolicyError, match="stands twice"):  # a part of it settles nothing
        load_policy(
            path, given={"period": 0.02, "observation.terms": {NAMES[0]: {"clip": [-1, 1]}}}
        )
    contract = load_policy(path, given={"period": 0.02, **said[key]})
    assert any(f"key {key!r} stands twice" in note for note in contract.notes)
    assert list(contract.joints) == (joints if key == "joint_names" else list(JOINTS))
    expected = [9.0, 8.0, 7.0, 6.0] if key == "joint_stiffness" else [40.179, 99.098] * 2
    assert contract.stiffness == pytest.approx(expected)
    assert contract.action.scale.tolist() == [0.5] * 4
    if key == "observation_terms_history_length":
        assert {term.history for term in contract.terms} == {2}
    elif key.startswith("observation"):
        assert contract.terms[0].scale.tolist() == [3.0]


def test_a_policy_yaml_beside_it_settles_a_key_that_stands_twice(tmp_path: Path) -> None:
    path = write_toy(tmp_path)
    for key in ("joint_stiffness", "joint_names", "observation_terms_scale"):
        metadata = [*NEW.items(), (key, TWICE[key])]
        metadata = [pair for pair in metadata if pair[0] in ("joint_names", key)]
        write_linear(tmp_path / "policy.onnx", 15, 4, metadata=metadata)
        contract = load_policy(path)
        assert contract.stiffness.tolist() == [10.0, 20.0, 30.0, 40.0]
        assert any(f"{key!r} stands twice" in note for note in contract.notes)
    write_linear(tmp_path / "policy.onnx", 15, 4, metadata=[*OLD.items(), ("run_path", "run-8")])
    with pytest.raises(PolicyError, match="metadata key 'run_path' stands twice"):
        load_policy(path)


def test_given_settles_what_two_sources_say(tmp_path: Path) -> None:
    path = write_toy(tmp_path)
    metadata = {key: OLD[key] for key in ("joint_names", "joint_stiffness")}
    write_linear(tmp_path / "policy.onnx", 15, 4, metadata=list(metadata.items()))
    with pytest.raises(PolicyError, match=r"stiffness of a_hip is 10 here and 40\.179 in the"):
        load_policy(path)
    contract = load_policy(path, given={"stiffness": [10.0, 20.0, 30.0, 40.0]})
    assert contract.stiffness.tolist() == [10.0, 20.0, 30.0, 40.0]
    assert any("is 10 here and 40.179 in the metadata" in note for note in contract.notes)


def test_given_facts_must_not_contradict_the_source(tmp_path: Path) -> None:
    path = write(tmp_path, OLD)
    given = {"period": 0.02, "observation.scale": 1.0, "stiffness": [40.0, 99.1, 40.2, 99.1]}
    with pytest.raises(PolicyError) as caught:
        load_policy(path, given=given)
    assert str(caught.value) == (
        f"{path}: mjlab metadata says stiffness is [40.179, 99.098, 40.179, 99.098] "
        "(joint_stiffness) and given says [40.0, 99.1, 40.2, 99.1]; remove it from 'given', or "
        "correct the file"
    )


def test_exact_values_may_replace_rounded_ones(tmp_path: Path) -> None:
    exact = [40.179238, 99.098428, 40.179238, 99.098428]
    given = {"period": 0.02, "observation.scale": 1.0, "stiffness": exact}
    contract = load_policy(write(tmp_path, OLD), given=given)
    np.testing.assert_array_equal(contract.stiffness, np.float32(exact))


@pytest.mark.parametrize("term", [0.05, None, "fast", [1.0], True])
def test_a_given_term_that_is_no_mapping_is_named(tmp_path: Path, term: Any) -> None:
    path = write(tmp_path, OLD)
    with pytest.raises(PolicyError) as caught:
        load_policy(path, given={"observation.terms": {"joint_pos": term}})
    assert str(caught.value) == (
        f"{path}: given observation.terms.joint_pos is {show(term)}; write {{scale: 0.05}}"
    )


@pytest.mark.parametrize("terms", [5, True, float("nan"), "joint_pos"])
def test_given_terms_that_are_no_collection_are_refused(tmp_path: Path, terms: Any) -> None:
    path = write(tmp_path, OLD)
    with pytest.raises(PolicyError) as caught:
        load_policy(path, given={"observation": {"terms": terms}})
    assert str(caught.value) == (
        f"{path}: given observation.terms is {show(terms)}; write {{joint_vel: {{scale: 0.05}}}} "
        "or a list"
    )


def test_given_terms_must_be_those_of_the_source(tmp_path: Path) -> None:
    path = write(tmp_path, OLD)
    with pytest.raises(PolicyError) as caught:
        load_policy(path, given={"observation": {"terms": {"joint_poss": {"scale": 1.0}}}})
    assert str(caught.value).startswith(
        f"{path}: given observation.terms has no term 'joint_poss' to change; did you mean "
        "'joint_pos'? known: "
    )
    with pytest.raises(PolicyError, match="name the same terms in the same order"):
        load_policy(path, given={"observation": {"terms": [{"name": "joint_pos"}]}})


HOLOSOMA = {
    "dof_names": json.dumps(list(JOINTS)),
    "kp": json.dumps([40.0, 99.0, 40.0, 99.0]),
    "kd": json.dumps([2.5, 6.3, 2.5, 6.3]),
    "command_ranges": json.dumps({"lin_vel_x": [-1.0, 1.0], "ang_vel_yaw": [-0.5, 0.5]}),
}


def test_the_scales_that_an_import_leaves_open_are_no_ones(tmp_path: Path) -> None:
    report = import_policy(write(tmp_path, OLD), tmp_path / "out", given={"period": 0.02})
    text = report.path.read_text("utf-8")
    assert "so add:\n#   scale of each term: where ? stands; 1.0 for none\n" in text
    with pytest.raises(PolicyError, match=r"observation\.terms\.\w+\.scale is '\?'; write a"):
        load_policy(report.path)
    report.path.write_text(text.replace("scale: '?'", "scale: 0.5"), "utf-8")
    assert {float(term.scale[0]) for term in load_policy(report.path).terms} == {0.5}
    report.path.write_text(text, "utf-8")
    given = load_policy(report.path, given={"observation.scale": 2.0})
    assert {float(term.scale[0]) for term in given.terms} == {2.0}


def test_a_policy_yaml_beside_metadata_may_have_the_names_of_the_robot(tmp_path: Path) -> None:
    given = {"period": 0.02, "observation.scale": 1.0}
    report = import_policy(write(tmp_path, OLD), tmp_path / "out", given=given)
    text = report.path.read_text("utf-8")
    for name in JOINTS:
        text = text.replace(name, f"{name}_joint")
    report.path.write_text(text, "utf-8")
    assert load_policy(report.path).joints == tuple(f"{name}_joint" for name in JOINTS)
    report.path.write_text(text.replace("stiffness: [", "stiffness: [1"), "utf-8")
    with pytest.raises(PolicyError, match="stiffness of a_hip_joint is 1"):
        load_policy(report.path)


def test_a_term_that_the_metadata_lack_is_given_with_the_others(tmp_path: Path) -> None:
    names = OLD["observation_names"].split(",")
    metadata = {**OLD, "observation_names": ",".join(names[:-1])}
    given = {"period": 0.02, "observation.scale": 1.0}
    path = write(tmp_path, metadata)
    added = {"name": names[-1], "state": "action"}
    terms = [*names[:-1], added]
    contract = load_policy(path, given=given)
    states = States({**standard_states(JOINTS), **policy_states(contract, JOINTS)})
    with pytest.raises(PolicyError, match=r"; give observation\.terms under 'given'$"):
        Policy(contract, states, robot())
    contract = load_policy(path, given=given | {"observation.terms": terms})
    assert [term.name for term in contract.terms] == names
    with pytest.raises(PolicyError, match="name the same terms in the same order; others may"):
        load_policy(path, given=given | {"observation.terms": [added, *names[1:-1]]})


def test_holosoma_says_joints_gains_and_ranges_only(tmp_path: Path) -> None:
    path = write(tmp_path, HOLOSOMA)
    with pytest.raises(PolicyError) as caught:
        load_policy(path)
    assert str(caught.value) == (
        f"{path}: the holosoma metadata does not say period (the control period in [s]); "
        "default_joint_pos (the default pose in [rad], policy order); action.scale (in [rad], one "
        "number or one for each joint); observation.terms (the terms of the network's input, in "
        "order); give it under 'given' in the workflow, with the keys of policy.yaml"
    )
    report = import_policy(path, tmp_path / "out")
    assert list(report.missing) == [
        "period",
        "default_joint_pos",
        "action.scale",
        "observation.terms",
    ]
    text = report.path.read_text("utf-8")
    assert "#   period: the control period in [s]" in text
    assert "stiffness: [40.0, 99.0, 40.0, 99.0]" in text
    assert "ang_vel_z: [-0.5, 0.5]" in text
    assert (tmp_path / "out" / "walk.onnx").is_file()
    with pytest.raises(PolicyError, match=r"the policy\.yaml does not say period"):
        load_policy(report.path)


def test_holosoma_gains_of_another_length_are_refused(tmp_path: Path) -> None:
    path = write(tmp_path, {**HOLOSOMA, "kd": "[1.0]"})
    with pytest.raises(PolicyError) as caught:
        load_policy(path)
    assert str(caught.value) == (
        f"{path}: metadata kd has 1 values for 4 dof_names; export the policy again"
    )


def tracking(tmp_path: Path, inputs: int = 29, urdf: str = '<link name="torso_link">') -> Path:
    """A network of holosoma's whole-body tracking: the reference counts its steps."""
    sizes = {"joint_pos": 4, "joint_vel": 4, "ref_pos_xyz": 3, "ref_quat_xyzw": 4}
    path = tmp_path / "dance.onnx"
    metadata = {**HOLOSOMA, "command_ranges": "null", "robot_urdf": json.dumps(urdf)}
    shapes = {"obs": [1, inputs], "time_step": [1, 1], "actions": [1, 4]}
    write_graph(
        path,
        "\n".join([HEAD, *(f"{name} = Add(time_step, c_{name})" for name in sizes)]),
        ["obs", "time_step"],
        shapes | {name: [1, size] for name, size in sizes.items()},
        SLICE | {f"c_{name}": np.arange(1.0 * size) for name, size in sizes.items()},
        list(metadata.items()),
    )
    return path


def test_holosoma_tracking_has_the_layout_of_its_one_program(tmp_path: Path) -> None:
    path = tracking(tmp_path)
    with pytest.raises(PolicyError) as caught:
        load_policy(path)
    assert str(caught.value) == (
        f"{path}: the holosoma whole-body tracking metadata does not say period (the control "
        "period in [s]); default_joint_pos (the default pose in [rad], policy order); action.scale "
        "(in [rad], one number or one for each joint); give it under 'given' in the workflow, with "
        "the keys of policy.yaml"
    )
    given = {"period": 0.02, "default_joint_pos": [0.0] * 4, "action.scale": 1.0}
    contract = load_policy(path, given=given)
    assert [(term.name, term.state) for term in contract.terms] == [
        ("actions", "action"),
        ("base_ang_vel", "base_ang_vel"),
        ("dof_pos", "joint_pos"),
        ("dof_vel", "joint_vel"),
        ("motion_command", "motion_command"),
        ("motion_ref_ori_b", "motion_anchor_ori_b"),
    ]
    assert contract.terms[2].subtract == "default_joint_pos"
    assert contract.outputs["motion_ref_quat_xyzw"] == "ref_quat_xyzw"
    assert contract.action.clip is not None
    assert contract.action.feedback == "clipped"
    assert contract.motion is not None
    assert contract.motion.anchor_body == "torso_link"
    assert load_policy(path, given={**given, "motion.end": 2.0}).motion.end == 2.0  # type: ignore[union-attr]
    with pytest.raises(PolicyError, match="obs has 40 elements, and its program's layout wbt"):
        load_policy(tracking(tmp_path, 40), given=given)
    with pytest.raises(PolicyError, match=r"motion \(the body that is compared; robot_urdf has no"):
        load_policy(tracking(tmp_path, urdf="<link>"), given=given)


def exploy(tmp_path: Path, *, extra: str | None = None, names: list[str] | None = None) -> Path:
    """Targets in the order b_knee … a_hip; memory counts the calls."""
    moved = list(reversed(JOINTS)) if names is None else names
    n = len(moved)
    inputs = {
        "obj.robot1.joints.pos": 4, "obj.robot1.joints.vel": 4, "obj.robot1.trunk.w_Q_b": 4,
        "cmd.se2_velocity.vel": 3, "memory.count.in": 1, **({extra: 3} if extra else {}),
    }  # fmt: skip
    sizes = {**inputs, "output.joint_targets.jt.pos": n, "memory.count.out": 1}
    nodes = """head = Slice(obj.robot1.joints.pos, zero, n, axes)
        output.joint_targets.jt.pos = Add(head, memory.count.in)
        memory.count.out = Add(memory.count.in, unit)"""
    constants = {"zero": [0, 0], "n": [1, n], "axes": [0, 1], "unit": [[1.0]]}
    ranges = {"lin_vel_x": [-1.5, 1.5], "lin_vel_y": [-0.75, 0.75], "ang_vel_z": [-2.5, 2.5]}
    gains = {"names": moved, "stiffness": [1.0, 2.0, 3.0, 4.0][:n], "damping": [0.1] * n}
    metadata = {
        "exploy_version": "0.1.0",
        "update_rate": 50.0,
        "output.joint_targets.jt": gains,
        "obj.robot1.joints": {"joint_names": list(JOINTS)},
        "cmd.se2_velocity.vel": {"ranges": ranges},
    }
    path = tmp_path / "exploy.onnx"
    shapes = {name: [1, size] for name, size in sizes.items()}
    written = [(k, json.dumps(v)) for k, v in metadata.items()]
    write_graph(path, nodes, list(inputs), shapes, constants, written)
    return path


def test_exploy_networks_take_states_by_name_and_remember(tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    path = exploy(tmp_path)
    with pytest.raises(PolicyError, match="does not say default_joint_pos"):
        load_policy(path)
    contract = load_policy(path, given={"default_joint_pos": [0.0] * 4})
    assert contract.period == pytest.approx(0.02)
    assert contract.joints == JOINTS
    assert contract.action.joints == tuple(reversed(JOINTS))
    assert contract.stiffness.tolist() == [4.0, 3.0, 2.0, 1.0]
    assert dict(contract.inputs) == {
        "joint_pos": "obj.robot1.joints.pos",
        "joint_vel": "obj.robot1.joints.vel",
        "base_quat": "obj.robot1.trunk.w_Q_b",
        "velocity_command": "cmd.se2_velocity.vel",
    }
    assert contract.command_ranges["ang_vel_z"] == (-2.5, 2.5)
    order = ("b_hip", "a_hip", "b_knee", "a_knee")
    toy = robot(order)
    states = States({**standard_states(order), **policy_states(contract, toy.joint_names)})
    policy = Policy(contract, states, toy)
    states.joint_pos = [3.0, 1.0, 4.0, 2.0]  # a_hip 1, a_knee 2, b_hip 3, b_knee 4
    policy()
    # The network adds its memory to the joints in its own order and calls them b_knee … a_hip.
    targets = dict(zip(order, states.joint_pos_target.tolist()))
    assert targets == {"b_knee": 1.0, "b_hip": 2.0, "a_knee": 3.0, "a_hip": 4.0}
    policy()
    assert states.action.tolist() == [2.0, 3.0, 4.0, 5.0]
    policy.warm_up()
    policy.warm_up()
    policy()
    assert states.action.tolist() == [3.0, 4.0, 5.0, 6.0]
    policy.reset()
    policy()
    assert states.action.tolist() == [1.0, 2.0, 3.0, 4.0]


def test_exploy_inputs_without_a_state_are_named(tmp_path: Path) -> None:
    path = exploy(tmp_path, extra="sensor.ray_caster.one.height")
    with pytest.raises(PolicyError) as caught:
        load_policy(path)
    assert str(caught.value) == (
        f"{path}: no state is known for the inputs sensor.ray_caster.one.height; write a "
        "policy.yaml with 'inputs: {STATE: INPUT}'"
    )


def test_the_assets_say_what_their_table_says(assets: Path) -> None:
    with pytest.raises(PolicyError, match="holosoma metadata does not say period"):
        load_policy(assets / "policies" / "g1_holosoma_ppo")
    with pytest.raises(PolicyError, match=r"ONNX file \(no metadata\) does not say period"):
        load_policy(assets / "policies" / "go1_playground")
