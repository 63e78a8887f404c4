"""Hands attached to a body: one model, one world, from the mounts of robot files and scenes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from unicon_base.errors import ModelError, RobotError, UniconError
from unicon_base.located_yaml import read_yaml
from unicon_core.check.pose import check_collision
from unicon_core.check.result import CheckResult
from unicon_core.models.find import pick_model
from unicon_core.models.load import load_model
from unicon_core.models.loaded import import_mujoco
from unicon_core.models.posed import PosedModel
from unicon_core.robots import compose, load_robot
from unicon_core.robots.robot import Place
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import Program

pytest.importorskip("mujoco")

QUICK = RunOptions(speed="max")
PARTS = ("proximal", "intermediate")
WRIST = {"left": "left_wrist_yaw_link", "right": "right_wrist_yaw_link"}


def g1_with(left, right, **mounts):
    members = {"body": "g1_29dof", "left_hand": left, "right_hand": right}
    return compose({name: load_robot(robot) for name, robot in members.items()}, mounts)


def attached(robot):
    return load_model(pick_model(robot), robot, quiet=True)


@pytest.fixture(scope="module")
def inspired(assets):
    robot = g1_with("inspire_rh56_left", "inspire_rh56_right")
    return robot, attached(robot)


def alone(name):
    robot = load_robot(name)
    return load_model(pick_model(robot), robot, quiet=True).model


def test_masses_are_those_of_the_parts(inspired):
    robot, loaded = inspired
    parts = ("g1_29dof", "inspire_rh56_left", "inspire_rh56_right")
    whole = sum(float(alone(part).body_mass.sum()) for part in parts)
    assert float(loaded.model.body_mass.sum()) == pytest.approx(whole, rel=1e-12)
    names = [loaded.model.joint(joint).name for joint in loaded.joints]
    assert names == list(robot.joint_names)


def test_what_is_pulled_along_follows_where_it_is_drawn(inspired):
    robot, loaded = inspired
    posed = PosedModel(loaded)
    pose = robot.default_joint_pos.copy()
    pose[robot.joint_names.index("L_index_proximal_joint")] = 1.2
    data = posed.put(pose)
    pulled = loaded.model.joint("L_index_intermediate_joint").qposadr[0]
    urdf = Path(pick_model(robot.members["left_hand"])).read_text("utf-8")
    _, mimic = urdf.split('joint="L_index_proximal_joint"', 1)
    factor = float(mimic.split('multiplier="', 1)[1].split('"', 1)[0])
    assert factor > 0.5
    assert data.qpos[pulled] == pytest.approx(1.2 * factor, abs=1e-6)
    assert data.qpos[loaded.model.joint("R_index_intermediate_joint").qposadr[0]] == 0.0


def test_a_hand_sits_where_the_vendors_model_has_it(inspired):
    """The DFQ model of unitree_ros: fingers along the wrist's x, thumbs inwards, mirrored."""
    model = inspired[1].model
    mujoco = import_mujoco()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    tips = {}
    for side, wrist in WRIST.items():
        at = data.body(wrist)
        turn = at.xmat.reshape(3, 3)
        tips[side] = turn.T @ (data.body(f"{side[0].upper()}_middle_tip").xpos - at.xpos)
    assert tips["left"][0] > 0.15
    np.testing.assert_allclose(tips["left"] * [1, -1, 1], tips["right"], atol=2e-3)


def test_dex3_hands_keep_their_joints_names(assets):
    robot = g1_with("dex3_left", "dex3_right")
    loaded = attached(robot)
    assert (
        loaded.model.body("left_hand_palm_link").parentid[0] == loaded.model.body(WRIST["left"]).id
    )
    np.testing.assert_allclose(loaded.model.body("left_hand_palm_link").pos, [0.0415, 0.003, 0.0])


def test_nothing_of_a_hand_touches_what_carries_it(inspired):
    model = inspired[1].model
    pairs = {(int(s) >> 16, int(s) & 0xFFFF) for s in model.exclude_signature}
    wrist = model.body(WRIST["left"]).id
    hand = [i for i in range(model.nbody) if model.body(i).name.startswith("L_")]
    assert hand
    assert all((min(wrist, i), max(wrist, i)) in pairs for i in hand)


def test_two_hands_of_one_file_get_names_of_their_own(assets):
    mounts = {f"{side}_hand": Place(body) for side, body in WRIST.items()}
    robot = g1_with("inspire_rh56_left", "inspire_rh56_left", **mounts)
    loaded = attached(robot)
    names = [loaded.model.joint(joint).name for joint in loaded.joints]
    assert names == list(robot.joint_names)
    assert "right_hand_L_index_proximal_joint" in names
    model = loaded.model
    assert model.neq == 12  # each mimic joint follows one of its own hand
    for pair in zip(model.eq_obj1id, model.eq_obj2id):
        sides = {model.joint(joint).name.startswith("right_hand_") for joint in pair}
        assert len(sides) == 1


def test_a_model_of_the_whole_is_left_as_it_is(assets, tmp_path):
    robot = g1_with("dex3_left", "dex3_right")
    joints = robot.joint_names[29:]
    bodies = "".join(f'<body><joint name="{name}"/><geom size="0.01"/></body>' for name in joints)
    body = pick_model(robot).read_text("utf-8")
    at = body.rindex("</worldbody>")
    whole = tmp_path / "whole.xml"
    whole.write_text(body[:at] + bodies + body[at:], "utf-8")
    loaded = load_model(whole, robot, quiet=True)
    assert not [note for note in loaded.notes if "attached" in note]


def test_key_frames_keep_the_bodys_joints(assets, tmp_path):
    robot = g1_with("dex3_left", "dex3_right")
    body = pick_model(robot).read_text("utf-8")
    values = " ".join(["0 0 0.7 1 0 0 0", *(f"0.{i:02d}" for i in range(29))])
    path = tmp_path / "keyed.xml"
    key = f'<keyframe><key name="k" qpos="{values}"/></keyframe></mujoco>'
    path.write_text(body.replace("</mujoco>", key), "utf-8")
    pose = load_model(path, robot, quiet=True).key_poses()["k"]
    np.testing.assert_allclose(pose[:29], np.arange(29) / 100)
    np.testing.assert_array_equal(pose[29:], 0.0)


def test_a_body_that_is_not_there_is_told_with_alternatives(assets):
    robot = g1_with("dex3_left", "dex3_right", left_hand=Place("left_wrist_yow_link"))
    with pytest.raises(
        ModelError, match=r"mounts.left_hand: no body 'left_wrist_yow_link' .*did you"
    ):
        attached(robot)


def test_two_hands_on_one_place_are_refused():
    here = Place(WRIST["left"])
    with pytest.raises(
        RobotError, match=r"left_hand and right_hand are both mounted on left_wrist"
    ):
        g1_with("dex3_left", "dex3_right", left_hand=here, right_hand=here)


def test_a_hand_without_model_is_told(assets):
    robot = g1_with("dex3_left", "dex3_right")
    bare = replace(robot.members["left_hand"], models={})
    robot = replace(robot, members={**robot.members, "left_hand": bare})
    with pytest.raises(ModelError, match="robot dex3_left names no model"):
        attached(robot)


def test_a_hand_without_a_mount_is_told():
    robot = g1_with("rohand", "dex3_right")
    with pytest.raises(
        ModelError, match=r"nothing says where left_hand sits on g1_29dof; .*mounts"
    ):
        pick_model(robot)


WORKFLOW: dict[str, Any] = {
    "robot": {"body": "g1_29dof", "left_hand": "dex3_left", "right_hand": "dex3_right"},
    "platform": "mujoco",
    "rate": 50,
    "flow": "hold",
}


@pytest.mark.parametrize(
    ("mounts", "said"),
    [
        ({"left_hnd": {"body": "x"}}, "scene.mounts: no member 'left_hnd'; did you mean"),
        ({"body": {"body": "x"}}, "scene.mounts: no member 'body'"),
        ({"left_hand": {"position": [0, 0, 0]}}, "scene.mounts.left_hand: missing key 'body'"),
        ({"left_hand": {"body": "x", "quat": [0, 0, 0, 0]}}, "quat has length 0"),
        (
            {"left_hand": {"body": "x", "position": [0, float("nan"), 0]}},
            "position.1 is nan; write a number",
        ),
        ({"left_hand": {"body": "x", "possition": [0, 0, 0]}}, "unknown key 'possition'; did you"),
        ([1], "scene.mounts is"),
    ],
)
def test_wrong_mounts_of_a_scene_are_refused(assets, mounts, said):
    with pytest.raises(UniconError, match=said.replace(".", r"\.").replace("[", r"\[")):
        Program(**WORKFLOW, scene={"mounts": mounts})


def test_another_simulator_refuses_in_one_line(assets):
    pytest.importorskip("pybullet")
    with pytest.raises(UniconError, match="cannot attach") as caught:
        Program(**{**WORKFLOW, "platform": "pybullet"})
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_g1_walks_with_hands_that_open_and_close(assets):
    pytest.importorskip("onnxruntime")
    seen: list[Any] = []

    def note() -> None:
        data = program.platform.data  # type: ignore[attr-defined]
        seen.append([float(data.joint(f"L_index_{p}_joint").qpos[0]) for p in PARTS])

    file = Path(__file__).parents[2] / "config" / "workflows" / "g1_hands.yaml"
    program = Program(**read_yaml(file, UniconError).value, deferred=[note])
    report = Runner(program, replace(QUICK, duration=10.0)).run()
    assert not report.faults
    assert float(program.states["base_pos_w"][0]) > 4.0
    driven, following = np.array(seen).T
    assert driven.max() > 1.2
    assert driven[driven.argmax() :].min() < 0.5  # it opens again
    np.testing.assert_allclose(following, driven, atol=0.05)  # the mimic joint holds


def test_what_a_hand_lacks_is_told_with_the_hands_own_file(inspired):
    robot, loaded = inspired
    result = CheckResult("g1_hands")
    check_collision(loaded, robot, result, None)
    hands = {pick_model(robot.members[f"{side}_hand"]) for side in ("left", "right")}
    assert hands & {*loaded.absent}
    culprits = {note.culprit for note in result.notes if note.code == "model.meshes"}
    assert culprits == {f"model {path}" for path in loaded.absent}
