"""The robot hand's kinematics: slopes against differences, followers, and files that do not fit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hands import HANDS, rohand_model, xhand_model

from unicon_base.errors import ModelError, RobotError
from unicon_core.models.load import load_model
from unicon_core.models.posed import PosedModel
from unicon_core.robots import Robot, compose, load_robot
from unicon_core.robots.robot import Hand, Place
from unicon_manipulation.retarget.hand_model import HandModel

Build = Callable[[str], HandModel]


@pytest.mark.parametrize("name", HANDS)
def test_slopes_are_those_of_differences(hand_model: Build, name: str) -> None:
    model, step = hand_model(name), 1e-6
    random = np.random.default_rng(3)
    for _ in range(5):
        q = random.uniform(model.lower, model.upper)
        model.put(q)
        told = model.jacobian.copy()
        for joint in range(len(q)):
            ends = []
            for way in (step, -step):
                moved = q.copy()
                moved[joint] += way
                model.put(moved)
                ends.append(model.points.ravel().copy())
            np.testing.assert_allclose(told[:, joint], (ends[0] - ends[1]) / (2 * step), atol=1e-7)


@pytest.mark.parametrize("name", HANDS)
def test_the_palm_is_turned_as_a_humans(hand_model: Build, name: str) -> None:
    """Fingers along x, bending to -z; the index finger on the thumb's side of the others."""
    model, side = hand_model(name), name.rpartition("_")[2]
    straight, shut = None, None
    for share in (0.0, 0.3):
        way = np.where(
            model.upper - model.default > model.default - model.lower, model.upper, model.lower
        )
        model.put(model.default + share * (way - model.default))
        ways = (model.tips - model.begins) @ model.palm
        straight, shut = (ways, shut) if share == 0.0 else (straight, ways)
    begins = model.begins @ model.palm
    for i, finger in enumerate(model.fingers):
        if finger != "thumb":
            assert straight[i, 0] > 0.9 * np.linalg.norm(straight[i])
            assert shut[i, 2] < straight[i, 2] - 0.01
    index, middle = (model.fingers.index(finger) for finger in ("index", "middle"))
    across = begins[index, 1] - begins[middle, 1]
    assert across > 0.01 if side == "right" else across < -0.01
    assert begins[0, 0] < begins[index, 0]


def test_joints_that_others_pull_along_are_where_they_are_drawn(assets: Path) -> None:
    robot = load_robot("inspire_rh56_left")
    model = HandModel(robot)
    drawn = PosedModel(load_model(Path(assets / robot.models["urdf"][7:]), robot, quiet=True))
    q = np.random.default_rng(0).uniform(model.lower, model.upper)
    model.put(q)
    data = drawn.put(q)
    for finger, tip in zip(model.fingers, model.tips):
        np.testing.assert_allclose(data.body(f"L_{finger}_tip").xpos, tip, atol=1e-12)


def test_followers_may_follow_followers_by_curves(tmp_path: Path) -> None:
    path = rohand_model(tmp_path, "left")
    text = path.read_text("utf-8")
    more = '<joint joint1="if_extra" joint2="if_distal_link" polycoef="0.1 -0.5 0.3 0 0"/>'
    tip = '<joint name="if_distal_link" axis="0 1 0"/>'
    extra = '<body name="x" pos="-0.02 0 -0.02"><geom type="sphere" size="0.004" mass="0.005"/>'
    extra += '<joint name="if_extra" axis="0 1 0"/></body>'
    path.write_text(text.replace(tip, tip + extra).replace("<equality>", f"<equality>{more}"))
    robot = load_robot("rohand")
    assert robot.hand is not None
    fingers = {**robot.hand.fingers, "index": Place("x", (-0.01, 0.0, -0.01))}
    robot = replace(robot, hand=replace(robot.hand, fingers=fingers))
    model = HandModel(robot, "left", str(path))
    drawn = PosedModel(load_model(path, robot, quiet=True))
    for q in np.random.default_rng(1).uniform(model.lower, model.upper, (5, 6)):
        model.put(q)
        told, column = model.jacobian.copy(), 1
        data = drawn.put(q)
        at = data.body("x").xpos + data.body("x").xmat.reshape(3, 3) @ (-0.01, 0.0, -0.01)
        np.testing.assert_allclose(model.tips[1], at, atol=1e-12)
        moved = q + 1e-6 * (np.arange(6) == column)
        before = model.tips[1].copy()
        model.put(moved)
        np.testing.assert_allclose(told[3:6, column], (model.tips[1] - before) / 1e-6, atol=1e-6)


def _hand(robot: Robot, **fingers: Place) -> Robot:
    assert robot.hand is not None
    return replace(robot, hand=replace(robot.hand, fingers={**robot.hand.fingers, **fingers}))


def test_what_does_not_fit_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    robot = load_robot("xhand1_left")
    path = str(xhand_model(tmp_path, "left"))
    assert robot.hand is not None
    with pytest.raises(ModelError, match=r"robot xhand1_left names no model \(mjcf or urdf\)"):
        HandModel(robot)
    with pytest.raises(
        ModelError, match=r"hand\.fingers\.index: no body 'left_hand_index_tip' in .*\.urdf;"
    ):
        HandModel(_hand(robot, index=Place("left_hand_index_tip")), "", path)
    with pytest.raises(
        ModelError, match=r"no joint of xhand1_left moves the tip of its ring; correct hand\.finger"
    ):
        HandModel(_hand(robot, ring=Place("left_hand_link")), "", path)
    palm = Hand(Place("left_hand_mid_link1"), robot.hand.fingers, "left")
    with pytest.raises(ModelError, match="joints of the hand move its palm 'left_hand_mid_link1'"):
        HandModel(replace(robot, hand=palm), "", path)
    palm = Hand(Place("palm"), robot.hand.fingers, "left")
    with pytest.raises(ModelError, match=r"hand\.palm: no body 'palm' in .*; known: left_hand"):
        HandModel(replace(robot, hand=palm), "", path)
    nowhere = np.array(robot.upper)
    nowhere[3] = np.nan
    with pytest.raises(RobotError, match="robot xhand1_left has no limits or no default pose for"):
        HandModel(replace(robot, upper=nowhere), "", path)
    with pytest.raises(RobotError, match=r"robot go2 has no hand; add hand: \{palm: …, fingers: …"):
        HandModel(load_robot("go2"))
    whole = compose({"body": load_robot("go2"), "left_hand": robot})
    with pytest.raises(RobotError, match="has no hand; say of whom: of: left_hand"):
        HandModel(whole)
