"""Chain: frames and Jacobians in the base frame."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from unicon_base.errors import RobotError, WorkflowError
from unicon_core.models.find import pick_model
from unicon_core.models.frames import Frames, turn_between, turned_by
from unicon_core.models.load import load_model
from unicon_core.robots import Robot, load_robot

Build = Callable[..., Any]


def unit(quat: Any) -> Any:
    return np.asarray(quat) / np.linalg.norm(quat)


def differences(it: Any, pose: Any, effector: int, step: float = 1e-6) -> Any:
    """Return the Jacobian of a frame by central differences, shape (6, k)."""
    columns = []
    for joint in range(len(pose)):
        ahead, behind = pose.copy(), pose.copy()
        ahead[joint] += step
        behind[joint] -= step
        (p, q), (p2, q2) = it.at(ahead, effector), it.at(behind, effector)
        columns.append([*(np.subtract(p, p2)), *turn_between(q2, q)])
    return np.array(columns).T / (2.0 * step)


def test_the_jacobian_is_that_of_finite_differences(arm: Robot, solved: Build) -> None:
    it, rng = solved(arm), np.random.default_rng(0)
    for _ in range(10):
        pose = it.random_pose(rng, 1.0)
        wanted = differences(it, pose, 0)
        it.chain.put(it.pose, pose)
        it.chain.differentiate()
        np.testing.assert_allclose(it.chain.jacobian[0], wanted, atol=1e-7)


def test_both_hands_of_a_robot_that_floats(g1: Robot, solved: Build) -> None:
    hands = ("left_hand", "right_hand")
    it = solved(g1, hands, ("arms", "waist"), apart=0.0)
    pose = it.random_pose(np.random.default_rng(1))
    wanted = np.array([differences(it, pose, i) for i in range(2)])
    it.chain.put(it.pose, pose)
    it.chain.differentiate()
    np.testing.assert_allclose(it.chain.jacobian, wanted, atol=1e-7)
    assert it.chain.carries.sum(axis=1).tolist() == [10, 10]


def test_frames_are_those_of_block_frames(arm: Robot, solved: Build) -> None:
    it = solved(arm)
    frames = Frames(load_model(pick_model(arm), arm, quiet=True), arm, arm.end_effectors)
    pose = it.random_pose(np.random.default_rng(2))
    found = frames.of(pose)["tool"]
    place, quat = it.at(pose)
    np.testing.assert_allclose(place, found[:3], atol=1e-9)
    np.testing.assert_allclose(np.abs(np.dot(quat, found[3:])), 1.0, atol=1e-9)


def test_some_joints_in_any_order_of_the_model(arm: Robot, solved: Build) -> None:
    it = solved(arm, moves=("yaw", "elbow", "twist"), apart=0.0)
    pose = np.array([0.2, -0.4, 1.0])
    wanted = differences(it, pose, 0)
    it.chain.put(it.pose, pose)
    it.chain.differentiate()
    np.testing.assert_allclose(it.chain.jacobian[0], wanted, atol=1e-7)


def test_an_end_effector_that_nothing_moves_is_refused(g1: Robot, solved: Build) -> None:
    with pytest.raises(WorkflowError) as caught:
        solved(g1, ("left_hand",), ("right_arm",))
    assert str(caught.value) == (
        "none of the joints that it moves carries 'left_hand'; name others under moves than "
        "right_shoulder_pitch_joint, right_shoulder_roll_joint, right_shoulder_yaw_joint, "
        "right_elbow_joint …"
    )


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("tool: {body: flange", "tool: {body: flanje", "end effector 'tool' is on body 'flanje'"),
        ("hand: {body: flange", "hand: {body: flanje", "capsule 'hand' is on body 'flanje'"),
    ],
)
def test_a_body_that_the_model_lacks_is_named(
    arm_file: Any, solved: Build, old: str, new: str, what: str
) -> None:
    arm_file.write_text(arm_file.read_text().replace(old, new))
    with pytest.raises(RobotError) as caught:
        solved(load_robot(arm_file))
    assert str(caught.value) == (
        f"robot welder: {what}, which model {arm_file.parent / 'welder.xml'} lacks; did you mean "
        "'flange'? known: flange, forearm, knuckle, plate, post, upper_arm, wrist; correct "
        f"{arm_file}"
    )


quats = st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1)


@given(quats, quats)
@settings(max_examples=100)
def test_a_turn_between_two_orientations_leads_there(a: list[float], b: list[float]) -> None:
    a, b = unit(a), unit(b)
    vector = turn_between(a, b)
    assert np.linalg.norm(vector) <= np.pi + 1e-9
    there = turned_by(a, vector, 1.0)
    assert abs(np.dot(there, b)) == pytest.approx(1.0, abs=1e-9)
