"""A wrong policy.yaml gets one line: file and line, the culprit, the remedy."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from policy_helpers import JOINTS, robot, toy_values, write_toy

from unicon_base.errors import PolicyError
from unicon_base.located_yaml import read_yaml
from unicon_core.policies import (
    PolicyContract,
    import_policy,
    load_policy,
    policy_names,
    write_policy_yaml,
)
from unicon_core.policies.file import build_contract
from unicon_core.policies.policy_yaml import contract_values, policy_yaml_facts

GOOD = """\
schema: unicon.policy/1
name: toy
onnx: policy.onnx
period: 0.02
joints: [a_hip, a_knee, b_hip, b_knee]
default_joint_pos: [0.1, 0.2, 0.3, 0.4]
action: {scale: 0.25}
stiffness: [10, 20, 30, 40]
damping: 1.0
observation:
  layout: term_major
  newest: last
  terms:
    - {name: ang_vel, state: base_ang_vel, scale: 0.25}
    - {name: joint_pos, state: joint_pos, subtract: default_joint_pos}
"""


def write(tmp_path: Path, *changes: tuple[str, str]) -> Path:
    text = GOOD
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "policy.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def read(path: Path) -> PolicyContract:
    return build_contract(policy_yaml_facts(read_yaml(path, PolicyError)))


def message(path: Path) -> str:
    with pytest.raises(PolicyError) as caught:
        read(path)
    text = str(caught.value)
    assert "\n" not in text
    assert text.startswith(str(path))
    return text.removeprefix(str(path))


def test_a_good_file_is_read(tmp_path: Path) -> None:
    contract = read(write(tmp_path))
    assert contract.joints == JOINTS
    assert contract.period == 0.02
    assert contract.damping.tolist() == [1.0] * 4
    assert contract.stiffness.dtype == np.float32
    assert contract.action.scale.tolist() == [0.25] * 4
    np.testing.assert_array_equal(contract.action.offset, contract.default_joint_pos)
    assert [term.name for term in contract.terms] == ["ang_vel", "joint_pos"]
    assert contract.terms[1].subtract == "default_joint_pos"
    assert contract.model == tmp_path / "policy.onnx"


ANGLE = "a number from -12.5664 to 12.5664 [rad] (are these degrees?)"


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("period: 0.02", "period: 0", ":4: period is 0; write a number from 1e-06 to 1000 [s]"),
        (
            "period: 0.02",
            "",
            ": the policy.yaml does not say period (the control period in [s]); "
            "add it to policy.yaml",
        ),
        # A misspelt fact is no missing one.
        (
            "stiffness:",
            "stifness:",
            ":8: unknown key 'stifness'; did you mean 'stiffness'? known: ",
        ),
        (
            "{scale: 0.25}",
            "{scal: 0.25}",
            ":7: action: unknown key 'scal'; did you mean 'scale'? known: clip, extra, feedback, "
            "filter, joints, kind, offset, scale",
        ),
        (
            "  terms:",
            "  trms:",
            ":13: observation: unknown key 'trms'; did you mean 'terms'? known: layout, newest, "
            "start, terms",
        ),
        (
            "state: base_ang_vel,",
            "stat: base_ang_vel,",
            ":14: observation.terms.ang_vel: unknown key 'stat'; did you mean 'state'? known: ",
        ),
        (
            "action: {scale: 0.25}",
            "action: 0.25",
            ":7: action is 0.25; write a mapping with scale, offset, kind, clip, joints, filter, "
            "feedback, extra",
        ),
        (
            "stiffness: [10, 20, 30, 40]",
            "stiffness: [10, 20, 30]",
            ":8: stiffness has 3 values for 4 joints; give one for each in policy order",
        ),
        (
            "stiffness: [10, 20, 30, 40]",
            "stiffness: [10, 20, .nan, 40]",
            ":8: stiffness.2 is nan; write a number from 0 to 2000 [N·m/rad]",
        ),
        (
            "stiffness: [10, 20, 30, 40]",
            "stiffness: [10, -20, 30, 40]",
            ":8: stiffness.1 is -20; write a number from 0 to 2000 [N·m/rad]",
        ),
        (
            "default_joint_pos: [0.1, 0.2, 0.3, 0.4]",
            "default_joint_pos: [0.1, x, 0.3, 0.4]",
            f":6: default_joint_pos.1 is 'x'; write {ANGLE}",
        ),
        (
            "default_joint_pos: [0.1, 0.2, 0.3, 0.4]",
            "default_joint_pos: {a_hip: 0.1, a_knee: 0.2, b_knee: 0.4}",
            ":6: default_joint_pos is {'a_hip': 0.1, 'a_knee': 0.2, 'b_knee': 0.4}; write "
            f"{ANGLE} or a list of them",
        ),
        (
            "default_joint_pos: [0.1, 0.2, 0.3, 0.4]",
            "default_joint_pos: [0.1, 0.2, -45, 0.4]",
            f":6: default_joint_pos.2 is -45; write {ANGLE}",
        ),
        (
            "default_joint_pos: [0.1, 0.2, 0.3, 0.4]",
            "default_joint_pos: [0.1, 51.57, 0.3, 0.4]",  # not the nearest float32
            f":6: default_joint_pos.1 is 51.57; write {ANGLE}",
        ),
        (
            "[a_hip, a_knee, b_hip, b_knee]",
            "[a_hip, a_knee, a_hip, b_knee]",
            ":5: joints names 'a_hip' twice; name each once",
        ),
        (
            "name: toy",
            "nane: toy",
            ":2: unknown key 'nane'; did you mean 'name'? known: ",
        ),
        (
            "{scale: 0.25}",
            "{scale: 0.25, clip: [1, -1]}",
            ":7: action.clip is [1, -1]; the lowest must come first",
        ),
        (
            "{scale: 0.25}",
            "{scale: 0.25, joints: [c_hip]}",
            ":7: action.joints names 'c_hip', which is not in joints; did you mean 'b_hip'? known: "
            "a_hip, a_knee, b_hip, b_knee",
        ),
        (
            "layout: term_major",
            "layout: terms_first",
            ":11: observation.layout 'terms_first' is not known; known: frame_major, term_major",
        ),
        (
            "newest: last",
            "newest: oldest",
            ":12: observation.newest 'oldest' is not known; did you mean 'last'? known: first, "
            "last",
        ),
        (
            "state: base_ang_vel, scale: 0.25",
            "state: base_ang_vel, value: 2.0, scale: 0.25",
            ":14: observation.terms.ang_vel.value is a constant and has a state; give one of state "
            "and value",
        ),
        (
            "name: ang_vel, state: base_ang_vel, scale: 0.25",
            "name: ang_vel, value: [2.0, .nan]",
            ":14: observation.terms.ang_vel.value.1 is nan; write a number from -1e+06 to 1e+06",
        ),
        (
            "name: ang_vel, state: base_ang_vel, scale: 0.25",
            "name: ang_vel, value: []",
            ":14: observation.terms.ang_vel.value is []; write a list of them",
        ),
        (
            "state: base_ang_vel, scale: 0.25",
            "state: base_ang_vel, scale: 0.25, history: 0",
            ":14: observation.terms.ang_vel.history is 0; write a whole number from 1 to 10000",
        ),
        (
            "state: base_ang_vel, scale: 0.25",
            "state: base_ang_vel, scale: 0.25, history: 10001",
            ":14: observation.terms.ang_vel.history is 10001; write a whole number from 1 to 10000",
        ),
        (
            "state: base_ang_vel, scale: 0.25",
            "state: base_ang_vel, index: [-1]",
            ":14: observation.terms.ang_vel.index.0 is -1; write a whole number from 0",
        ),
        (
            "subtract: default_joint_pos",
            "subtract: default_pose",
            ":15: observation.terms.joint_pos.subtract is 'default_pose'; write "
            "default_joint_pos or a number or a list of them or null",
        ),
        (
            "schema: unicon.policy/1",
            "schema: unicon.policy/9",
            ":1: schema is 'unicon.policy/9'; write unicon.policy/1",
        ),
        (
            "onnx: policy.onnx",
            "onnx: policy.onnx\nsha256: abc",
            ":4: sha256 is 'abc'; write the 64 digits of 'sha256sum', or null",
        ),
        (
            "damping: 1.0",
            "damping: 1.0\nphase: {period: -1}",
            ":10: phase.period is -1; write a number from 1e-06 to 1000 [s]",
        ),
        (
            "damping: 1.0",
            "damping: 1.0\nrecurrent: [{input: h}]",
            ":10: recurrent.0: missing key 'output'; add output: the name of a tensor",
        ),
        (
            "damping: 1.0",
            "damping: 1.0\ndamping: 2.0",
            ":10: not valid YAML: key 'damping' stands twice, first in line 9; remove one",
        ),
        ("damping: 1.0", "damping: [1.0", ":10: not valid YAML: "),
    ],
)
def test_a_wrong_file_gets_one_line(tmp_path: Path, old: str, new: str, expected: str) -> None:
    text = message(write(tmp_path, (old, new)))
    if expected.endswith(
        (": ", "? ")
    ):  # what follows is a list of names, or the parser's own words
        assert text.startswith(expected)
    else:
        assert text == expected


def test_all_mistakes_are_named_at_once_with_their_lines(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        ("period: 0.02", "perod: 0.02"),
        ("{scale: 0.25}", "{scale: fast, joints: [c_hip]}"),
        ("[10, 20, 30, 40]", "[10, -20, 30]"),
        ("damping: 1.0", "damping: [1.0]"),
        ("0.4]", "0.4, 0.5]"),
        ("state: base_ang_vel", "state: base_ang_vel, filter: {alpha: 2}, hist: 3"),
    )
    with pytest.raises(PolicyError) as caught:
        read(path)
    first, *others = str(caught.value).splitlines()
    assert first == f"policy {path} has 6 mistakes:"
    found = [line.split(f"{path}:")[1].split("; ")[0] for line in others]
    assert found == [
        "4: unknown key 'perod'",
        "6: default_joint_pos has 5 values for 4 joints",
        "7: action.scale is 'fast'",
        "8: stiffness.1 is -20",
        "14: observation.terms.ang_vel: unknown key 'hist'",
        "14: observation.terms.ang_vel.filter.alpha is 2",
    ]


def test_facts_that_miss_do_not_hide_the_mistakes_of_others(tmp_path: Path) -> None:
    path = write(tmp_path, ("stiffness: [10, 20, 30, 40]\n", ""), ("1.0", "-1.0"))
    assert message(path) == ":8: damping is -1.0; write a number from 0 to 200 [N·m·s/rad]"


def test_all_missing_facts_are_named_at_once(tmp_path: Path) -> None:
    path = tmp_path / "policy.yaml"
    path.write_text("schema: unicon.policy/1\nonnx: policy.onnx\nperiod: 0.02\n", "utf-8")
    assert message(path) == (
        ": the policy.yaml does not say joints (the joint names in policy order); "
        "default_joint_pos (the default pose in [rad], policy order); stiffness (in [N·m/rad], "
        "policy order); damping (in [N·m·s/rad], policy order); action.scale (in [rad], one number "
        "or one for each joint); observation.terms (the terms of the network's input, in order); "
        "add it to policy.yaml"
    )


def test_joints_that_are_no_list_are_refused(tmp_path: Path) -> None:
    path = write_toy(tmp_path, toy_values(joints=3))
    with pytest.raises(PolicyError, match="joints is 3; write a list of joint names"):
        load_policy(path)


def test_an_import_refuses_a_misspelt_fact_too(tmp_path: Path) -> None:
    values = toy_values()
    path = write_toy(tmp_path / "in", {**values, "stifness": values.pop("stiffness")})
    with pytest.raises(PolicyError, match="unknown key 'stifness'; did you mean 'stiffness'"):
        import_policy(path, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_term_without_a_state_is_asked_for_by_name(tmp_path: Path) -> None:
    text = message(write(tmp_path, ("state: base_ang_vel, ", "")))
    assert text == (
        ": the policy.yaml does not say observation.terms.ang_vel.state (the state that it is "
        "taken from); add it to policy.yaml"
    )


@pytest.mark.parametrize(
    ("observation", "expected"),
    [
        ("5", "observation is 5; "),
        ("{terms: [5]}", "observation.terms.0 is 5; write a mapping with name, state, "),
        ("{terms: 5}", "observation.terms is 5; write a list, each a mapping with name, state, "),
    ],
)
def test_a_wrong_observation_is_refused_where_terms_are_given(
    tmp_path: Path, observation: str, expected: str
) -> None:
    path = write(tmp_path)
    text = path.read_text("utf-8")
    path.write_text(f"{text[: text.index('observation:')]}observation: {observation}\n", "utf-8")
    write_toy(tmp_path / "network")
    (tmp_path / "policy.onnx").write_bytes((tmp_path / "network/policy.onnx").read_bytes())
    with pytest.raises(PolicyError, match=re.escape(expected)):
        load_policy(path, given={"observation.terms": {"ang_vel": {"scale": 1.0}}})


def test_what_is_written_reads_back_equal(tmp_path: Path) -> None:
    values = toy_values(
        action={
            "joints": ["b_knee", "a_hip"],
            "scale": [0.5, 0.1],
            "offset": [0.3, 1 / 3],
            "clip": [[-1.0, -2.0], 4.0],
            "feedback": "clipped",
        },
        observation={
            "layout": "frame_major",
            "newest": "first",
            "start": "zeros",
            "terms": [
                {"name": "g", "state": "projected_gravity", "history": 2,
                 "clip": [[-1, -2, -3], 1]},
                {"name": "a", "state": "action", "history": 2, "scale": [0.1, 0.7]},
                {"name": "c", "state": "velocity_command", "history": 2, "index": [2],
                 "subtract": 0.5},
            ],
        },
        command_ranges={"lin_vel_x": [-0.5, 1.0]},
        phase={"period": 0.8, "offsets": [0.0], "stand": None},
        recurrent=[],
        inputs={"observation": "obs"},
        outputs={"action": "actions"},
    )  # fmt: skip
    first = read(write_toy(tmp_path / "in", values))
    second = read(write_policy_yaml(first, tmp_path / "out"))
    one, two = contract_values(first), contract_values(second)
    assert len(two.pop("sha256")) == 64
    assert one == two
    assert first.action.clip is not None
    assert second.action.clip is not None
    np.testing.assert_array_equal(first.action.clip, second.action.clip)
    assert (tmp_path / "out" / "policy.onnx").is_file()


def test_another_network_than_the_one_written_for_is_refused(tmp_path: Path) -> None:
    path = write_policy_yaml(load_policy(write_toy(tmp_path / "in")), tmp_path / "out")
    load_policy(path)
    with (tmp_path / "out" / "policy.onnx").open("ab") as file:
        file.write(b"\x12\x00")  # an empty producer name: still the same network to read
    with pytest.raises(
        PolicyError,
        match=r"policy\.yaml:\d+: policy\.onnx has sha256 \w{12}… and "
        r"not \w{12}…; it is not the network that this contract was written for",
    ):
        load_policy(path)  # fmt: skip


def test_a_missing_network_is_named(tmp_path: Path) -> None:
    path = write(tmp_path)
    with pytest.raises(PolicyError) as caught:
        load_policy(path)
    assert str(caught.value) == (
        f"{tmp_path / 'policy.onnx'}: no such ONNX file; put it there or correct the path"
    )


def test_a_policy_is_found_by_folder_file_and_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "policies" / "toy_walk"
    path = write_toy(folder, toy_values(name=None))
    assert load_policy(folder).name == "toy_walk"
    assert load_policy(path).name == "toy_walk"
    assert load_policy(folder / "policy.onnx").source == "policy.yaml"
    monkeypatch.setenv("UNICON_PATH", str(tmp_path))
    assert "toy_walk" in policy_names()
    assert load_policy("toy_walk").path == path


def test_an_unknown_name_gets_the_alternatives(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_toy(tmp_path / "policies" / "toy_walk")
    monkeypatch.setenv("UNICON_PATH", str(tmp_path))
    with pytest.raises(PolicyError) as caught:
        load_policy("toy_wakl")
    text = str(caught.value)
    assert text.startswith("unknown policy 'toy_wakl'; did you mean 'toy_walk'? known: ")
    assert text.endswith("; or give a path to a folder or file")


def test_an_empty_folder_is_told_what_belongs_there(tmp_path: Path) -> None:
    with pytest.raises(PolicyError) as caught:
        load_policy(tmp_path)
    assert str(caught.value) == (
        f"{tmp_path}: no policy in this folder; put policy.yaml, deploy.yaml, env.yaml or exactly "
        "one .onnx there"
    )


def test_metadata_that_disagree_with_the_file_are_refused(tmp_path: Path) -> None:
    from policy_helpers import write_linear

    metadata = [
        ("joint_names", "b_knee,a_hip,a_knee,b_hip"),
        ("joint_stiffness", "40.000,10.000,25.000,30.000"),
        ("joint_damping", "4.000,1.000,2.000,3.000"),
        ("default_joint_pos", "0.400,0.100,0.200,0.300"),
        ("action_scale", "0.25"),
    ]
    write_linear(tmp_path / "policy.onnx", 15, 4, metadata=metadata)
    path = write_toy(tmp_path)
    line = next(
        i for i, text in enumerate(path.read_text("utf-8").splitlines(), 1) if "stiffness" in text
    )
    with pytest.raises(PolicyError) as caught:
        load_policy(path, robot=robot())
    assert str(caught.value) == (
        f"{path}:{line}: stiffness of a_knee is 20 here and 25 in the metadata of policy.onnx; "
        "correct one of them, or export both again"
    )
    values = toy_values(stiffness=[10.0, 25.0, 30.0, 40.0])
    path.write_text(yaml.safe_dump(values), "utf-8")
    assert load_policy(path).stiffness.tolist() == [10.0, 25.0, 30.0, 40.0]
    for broken in ([["a_hip"]] * 4, [{"a": 1}] * 4):
        action = {"scale": 0.25, "joints": broken}
        path.write_text(yaml.safe_dump({**values, "action": action}), "utf-8")
        with pytest.raises(PolicyError, match=r"action\.joints"):
            load_policy(path)
