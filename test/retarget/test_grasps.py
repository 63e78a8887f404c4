"""The shape of a grasp is kept whatever the human's size: order of bending, pinch, sides."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hands import HANDS
from human_hands import human_hand, pinched, placed

from unicon_manipulation.retarget.hand_model import HandModel, HumanHand
from unicon_manipulation.retargeting_block import Retargeting

Build = Callable[[str], HandModel]
SIZES = (0.8, 1.0, 1.2)
DIVERSE = {"thumb": 0.1, "index": 0.2, "middle": 0.45, "ring": 0.7, "pinky": 0.9}


def retargeted(
    model: HandModel, poses: np.ndarray, contact: float = 0.0, side: str = ""
) -> Retargeting:
    """Return what is found for one human hand, of lengths that are measured."""
    hand = HumanHand(poses, model.fingers, side)
    assert hand.look() == ""
    found = Retargeting(model, contact)
    found.solve(hand, model.reach / hand.lengths, anew=True)
    return found


def bent(model: HandModel, q: np.ndarray) -> dict[str, float]:
    """Return how near each tip is to where its finger begins: 0 at its reach, 1 there."""
    model.put(q)
    far = np.linalg.norm(model.tips - model.begins, axis=1)
    return dict(zip(model.fingers, 1.0 - far / model.reach))


@pytest.mark.parametrize("name", HANDS)
def test_fingers_bend_in_the_order_of_the_humans(hand_model: Build, name: str) -> None:
    model, side = hand_model(name), name.rpartition("_")[2]
    for size in SIZES:
        for order in (1, -1):
            fingers = [finger for finger in DIVERSE if finger != "thumb"]
            bends = dict(zip(fingers[::order], (0.2, 0.45, 0.7, 0.9)))
            found = retargeted(model, human_hand(bends, size, side), side=side)
            shares = bent(model, found.q)
            there = [finger for finger in fingers if finger in model.fingers]
            assert sorted(there, key=shares.__getitem__) == sorted(there, key=bends.__getitem__)


@pytest.mark.parametrize("name", HANDS)
def test_an_open_hand_is_open_and_a_fist_is_shut(hand_model: Build, name: str) -> None:
    model, side = hand_model(name), name.rpartition("_")[2]
    for size in SIZES:
        straight = bent(model, retargeted(model, human_hand({}, size, side)).q)
        shut = bent(model, retargeted(model, human_hand(dict.fromkeys(DIVERSE, 0.9), size, side)).q)
        for finger in model.fingers:
            if finger != "thumb":
                assert straight[finger] < 0.02, finger
                assert shut[finger] > 0.2, finger


@pytest.mark.parametrize("name", HANDS)
def test_the_size_of_the_human_is_nothing_to_the_robot(hand_model: Build, name: str) -> None:
    model, side = hand_model(name), name.rpartition("_")[2]
    for poses in (human_hand(DIVERSE, 1.0, side), pinched("index", 0.0, 1.0, side)):
        one = retargeted(model, poses).q
        for size in SIZES:
            sized = poses.copy()
            sized[:, :3] *= size
            np.testing.assert_allclose(retargeted(model, sized).q, one, atol=1e-3)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("name", HANDS)
def test_a_pinch_closes_where_the_hand_can(hand_model: Build, name: str, size: float) -> None:
    """With thumb and index all can; Inspire's thumb gets within 10 to 16 mm of the middle one."""
    model, side = hand_model(name), name.rpartition("_")[2]
    index = model.fingers.index("index")
    for apart, contact in ((0.0, 0.0), (0.01, 0.015)):
        found = retargeted(model, pinched("index", apart, size, side), contact)
        model.put(found.q)
        assert np.linalg.norm(model.tips[index] - model.tips[0]) < 0.002


@pytest.mark.parametrize("name", HANDS)
def test_tips_that_stay_apart_stay_apart(hand_model: Build, name: str) -> None:
    model, side = hand_model(name), name.rpartition("_")[2]
    found = retargeted(model, pinched("index", 0.03, 1.0, side), contact=0.01)
    model.put(found.q)
    apart = np.linalg.norm(model.tips[model.fingers.index("index")] - model.tips[0])
    assert apart > 0.01


@pytest.mark.parametrize("kind", ["xhand1", "rohand"])
def test_a_left_hand_is_a_right_one_in_a_mirror(hand_model: Build, kind: str) -> None:
    left, right = (hand_model(f"{kind}_{side}") for side in ("left", "right"))
    np.testing.assert_allclose(left.reach, right.reach, atol=1e-9)
    for poses in (human_hand, lambda bends, size, side: pinched("index", 0.01, size, side)):
        one = retargeted(left, poses(DIVERSE, 1.0, "left"), side="left").q
        other = retargeted(right, poses(DIVERSE, 1.0, "right"), side="right").q
        np.testing.assert_allclose(one, other, atol=1e-5)


def test_a_left_human_may_lead_a_right_robot_hand(hand_model: Build) -> None:
    model = hand_model("xhand1_right")
    right = retargeted(model, human_hand(DIVERSE, 1.0, "right")).q
    poses = human_hand(DIVERSE, 1.0, "left")
    hand = HumanHand(poses, model.fingers, "left", mirrored=True)
    assert hand.look() == ""
    found = Retargeting(model, 0.0)
    found.solve(hand, model.reach / hand.lengths, anew=True)
    np.testing.assert_allclose(found.q, right, atol=1e-9)


def test_where_the_hand_is_in_the_room_is_nothing_to_it(hand_model: Build) -> None:
    model = hand_model("xhand1_right")
    poses = human_hand(DIVERSE)
    elsewhere = placed(poses, np.array((0.3, -0.8, 0.5)), 2.0, np.array((3.0, -1.0, 1.2)))
    np.testing.assert_allclose(
        retargeted(model, elsewhere).q, retargeted(model, poses).q, atol=2e-4
    )


def test_what_cannot_be_reached_is_told(hand_model: Build) -> None:
    """A thumb that points away from all that the robot's can do, by centimetres."""
    model = hand_model("xhand1_right")
    near = retargeted(model, human_hand({}))
    poses = human_hand({})
    poses[2:5, :3] = poses[1, :3] - (poses[2:5, :3] - poses[1, :3])
    far = retargeted(model, poses)
    assert far.errors[0] > 0.05 > near.errors[1]
    assert (far.q >= model.lower).all()
    assert (far.q <= model.upper).all()
