"""Facts that are taken from the robot's model, with a yes for each, and offered by name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from motion_helpers import JOINTS, MODEL, MODEL_ORDER, waisted
from policy_helpers import toy_values, write_linear, write_toy

from unicon_base.errors import PolicyError
from unicon_core.policies import PolicyContract, load_policy
from unicon_core.policies.from_model import FromModel
from unicon_core.robots import Robot, load_robot

pytest.importorskip("mujoco", reason="models are read by mujoco")

DRIVEN = (
    '<actuator><position joint="leg" kp="30" kv="1.5"/><position joint="arm" kp="10" kv="0.5"/>'
    '<position joint="waist_yaw" kp="20" kv="1" gear="2"/>'
    '<position joint="waist_pitch" kp="25" kv="1"/></actuator>'
)
FRAMES = (
    '<keyframe><key name="home" qpos="0 0 1 1 0 0 0 0.1 0.2 0.3 0.4"/>'
    '<key name="crouch" qpos="0 0 1 1 0 0 0 1.1 1.2 1.3 1.4"/></keyframe>'
)
FACTS = ("joints", "default_joint_pos", "stiffness", "damping")


def machine(folder: Path, *parts: str) -> Robot:
    """The robot with a waist, whose file names a model with more in it."""
    model = folder / "robot.xml"
    model.write_text(MODEL.replace("</mujoco>", "".join(parts) + "</mujoco>"), "utf-8")
    made = waisted()
    return type(made)(
        **{**vars(made), "models": {"mjcf": "robot.xml"}, "path": folder / "toy.yaml"}
    )


def load(folder: Path, robot: Robot | None, **given: Any) -> PolicyContract:
    values = toy_values(**dict.fromkeys(FACTS))
    path = folder / "walk" / "policy.yaml"
    write_toy(path.parent, values)
    return load_policy(path, robot=robot, given=given)


def test_each_fact_is_taken_where_it_is_said(tmp_path: Path) -> None:
    robot = machine(tmp_path, DRIVEN, FRAMES)
    contract = load(
        tmp_path,
        robot,
        joints={"from": "model"},
        default_joint_pos={"from": "model", "keyframe": "crouch"},
        stiffness={"from": "model"},
        damping={"from": "model"},
    )
    assert contract.joints == tuple(MODEL_ORDER)
    assert contract.default_joint_pos == pytest.approx([1.1, 1.2, 1.3, 1.4])
    assert contract.stiffness.tolist() == [80.0, 25.0, 10.0, 30.0]  # a gear counts twice
    assert contract.damping.tolist() == [4.0, 1.0, 0.5, 1.5]
    assert any(
        "joints is taken from the depth first order of robot.xml: waist_yaw, waist_pitch" in note
        for note in contract.notes
    )
    assert any("key frame crouch of robot.xml: 1.1, 1.2" in note for note in contract.notes)


@pytest.mark.parametrize(
    ("asked", "expected"),
    [
        ({"order": "breadth_first"}, ["waist_yaw", "leg", "waist_pitch", "arm"]),
        ({"order": "actuators"}, ["leg", "arm", "waist_yaw", "waist_pitch"]),
        ({"only": ["waist_*", "leg"]}, ["waist_yaw", "waist_pitch", "leg"]),
        ({"only": "waist_*", "order": "actuators"}, ["waist_yaw", "waist_pitch"]),
    ],
)
def test_orders_and_parts(tmp_path: Path, asked: dict[str, Any], expected: list[str]) -> None:
    robot = machine(tmp_path, DRIVEN)
    values = {"default_joint_pos": 0.0, "stiffness": 1.0, "damping": 0.1}
    write_linear(tmp_path / "walk" / "policy.onnx", 15, len(expected))
    contract = load(tmp_path, robot, joints={"from": "model", **asked}, **values)
    assert list(contract.joints) == expected
    # In policy order, whatever the model's is.
    kp = load(tmp_path, robot, joints=expected, **{**values, "stiffness": {"from": "model"}})
    gains = {"leg": 30.0, "arm": 10.0, "waist_yaw": 80.0, "waist_pitch": 25.0}
    assert kp.stiffness.tolist() == [gains[name] for name in expected]


def test_breadth_first_is_the_order_of_isaac(assets: Path) -> None:
    """fan-ziqi/rl_sar, g1/whole_body_tracking: joint_mapping of a policy trained in Isaac Lab."""
    isaac = [0, 6, 12, 1, 7, 13, 2, 8, 14, 3, 9, 15, 22, 4, 10, 16, 23, 5, 11, 17, 24, 18, 25]
    isaac += [19, 26, 20, 27, 21, 28]
    robot = load_robot("g1_29dof")
    model = assets / "models" / "g1_29dof" / "g1_29dof.xml"
    asked = {"joints": {"from": "model", "order": "breadth_first"}}
    said = FromModel(Path("policy"), asked, robot, lambda: model)
    said.joints("depth_first")
    assert said.given["joints"] == [robot.joint_names[i] for i in isaac]


def test_missing_facts_are_offered_by_name_and_never_taken(tmp_path: Path) -> None:
    robot = machine(tmp_path, DRIVEN, FRAMES)
    with pytest.raises(PolicyError) as caught:
        load(tmp_path, robot)
    assert str(caught.value).endswith(
        "add it to policy.yaml; model robot.xml can say some of it: given: {joints: {from: model}, "
        "default_joint_pos: {from: model, keyframe: home | crouch}, stiffness: {from: model}, "
        "damping: {from: model}}"
    )
    with pytest.raises(PolicyError) as caught:
        load(tmp_path, machine(tmp_path))  # motors, no key frame
    assert str(caught.value).endswith("can say some of it: given: {joints: {from: model}}")
    with pytest.raises(PolicyError) as caught:
        load(tmp_path, None)
    assert "model" not in str(caught.value)
    passive = DRIVEN.replace(' kv="1.5"', "").replace(' kv="0.5"', "").replace(' kv="1"', "")
    model = MODEL.replace('name="leg"', 'name="leg" damping="0.7"')
    (tmp_path / "robot.xml").write_text(model.replace("</mujoco>", passive + "</mujoco>"), "utf-8")
    with pytest.raises(PolicyError, match=r"damping: {from: model, of: joints}}"):
        load(tmp_path, robot)
    rest: dict[str, Any] = {"joints": list(JOINTS), "default_joint_pos": 0.0, "stiffness": 1.0}
    with pytest.raises(PolicyError, match=r"whose actuators have none; its joints have 0\.7"):
        load(tmp_path, robot, damping={"from": "model"}, **rest)
    contract = load(tmp_path, robot, damping={"from": "model", "of": "joints"}, **rest)
    assert contract.damping == pytest.approx([0.7, 0.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("period", {"from": "model"}, "a model says only joints, default_joint_pos, stiffness"),
        ("joints", {"from": "robot"}, "given joints.from is 'robot'; write model"),
        ("joints", {"from": "model", "ordr": 1}, "unknown key 'ordr'; did you mean 'order'?"),
        (
            "joints",
            {"from": "model", "order": "x"},
            "given joints.order 'x' is not known; known: actuators, breadth_first, depth",
        ),
        (
            "joints",
            {"from": "model", "only": 3},
            "given joints.only is 3; write a text or a list, each a text",
        ),
        ("joints", {"from": "model", "only": ["toe_*"]}, "'toe_*', which is none of the model's"),
        ("default_joint_pos", {"from": "model"}, "key frames home, crouch; say which: {from: mod"),
        ("default_joint_pos", {"from": "model", "keyframe": "hme"}, "did you mean 'home'?"),
        (
            "damping",
            {"from": "model", "of": "x"},
            "given damping.of 'x' is not known; known: actuators, joints",
        ),
    ],
)
def test_mistakes_get_one_line(tmp_path: Path, key: str, value: Any, message: str) -> None:
    robot = machine(tmp_path, DRIVEN, FRAMES)
    rest: dict[str, Any] = {"joints": list(JOINTS)} if key != "joints" else {}
    with pytest.raises(PolicyError) as caught:
        load(tmp_path, robot, **{**rest, key: value})
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_a_model_lacks_is_refused(tmp_path: Path) -> None:
    joints = {"joints": list(JOINTS)}
    with pytest.raises(PolicyError, match="is from the model of a robot, and none is named"):
        load(tmp_path, None, joints={"from": "model"})
    with pytest.raises(PolicyError, match=r"robot\.xml has no key frame"):
        load(tmp_path, machine(tmp_path), default_joint_pos={"from": "model"}, **joints)
    with pytest.raises(PolicyError, match=r"robot\.xml has no position actuator for leg; give"):
        load(tmp_path, machine(tmp_path), stiffness={"from": "model"}, **joints)
    with pytest.raises(PolicyError, match=r"robot\.xml has no joint 'tail'; known: "):
        load(tmp_path, machine(tmp_path), stiffness={"from": "model"}, joints=["leg", "tail"])
    with pytest.raises(PolicyError, match="stiffness is from the model, and the joints are not"):
        load(tmp_path, machine(tmp_path), stiffness={"from": "model"})
    gone = machine(tmp_path)
    (tmp_path / "robot.xml").unlink()
    with pytest.raises(PolicyError, match="given joints is from the model: "):
        load(tmp_path, gone, joints={"from": "model"})
