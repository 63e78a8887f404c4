"""A human hand is looked at before it is followed: absent, garbage, too large, another side."""

from __future__ import annotations

import numpy as np
import pytest
from human_hands import human_hand, placed
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from unicon_core.robots.robot import FINGERS
from unicon_hardware.peripherals.webxr.webxr import JOINTS
from unicon_manipulation.retarget.human_hand import ABSENT, CHAINS, HumanHand

NEUTRAL = np.tile(np.array((0, 0, 0, 1, 0, 0, 0), np.float32), (25, 1))


def look(poses: np.ndarray, side: str = "right") -> str:
    return HumanHand(poses, FINGERS, side).look()


def test_the_joints_are_those_of_the_headset() -> None:
    for finger, chain in CHAINS.items():
        words = [JOINTS[joint] for joint in chain]
        assert all(word.startswith(finger) for word in words)
        assert words[-1].endswith("tip")
        bones = ("metacarpal", "phalanx-proximal", "phalanx-distal")
        if finger != "thumb":
            bones = ("phalanx-proximal", "phalanx-intermediate", "phalanx-distal")
        assert [word.partition("-")[2].removeprefix("finger-") for word in words[:3]] == [*bones]


def test_lengths_are_those_of_the_bones_however_they_bend() -> None:
    lengths = []
    for bend in (0.0, 0.5, 1.0):
        hand = HumanHand(human_hand(dict.fromkeys(FINGERS, bend)), FINGERS, "right")
        assert hand.look() == ""
        lengths.append(hand.lengths.copy())
    np.testing.assert_allclose(lengths, [[0.1, 0.078, 0.088, 0.084, 0.067]] * 3, atol=1e-6)


def test_vectors_are_in_the_wrists_frame() -> None:
    poses = human_hand({"index": 0.5})
    hand = HumanHand(poses, FINGERS, "right")
    hand.look()
    before = hand.vectors.copy(), hand.tips.copy(), hand.knee.copy()
    poses[...] = placed(poses, np.array((1.0, 2.0, -0.5)), 1.3, np.array((0.5, 0.2, 1.0)))
    assert hand.look() == ""
    for one, other in zip(before, (hand.vectors, hand.tips, hand.knee)):
        np.testing.assert_allclose(one, other, atol=1e-6)


@pytest.mark.parametrize("joint", [0, 4, 9, 24])
def test_what_is_not_told_is_absent(joint: int) -> None:
    assert look(NEUTRAL.copy()) == ABSENT
    assert look(np.zeros((25, 7), np.float32)) == ABSENT
    assert look(np.full((25, 7), np.nan, np.float32)) == ABSENT
    poses = human_hand({})
    poses[joint] = np.nan
    assert look(poses) == ABSENT


def _stretched(poses: np.ndarray) -> None:
    poses[9, :3] += (1.0, 0.0, 0.0)


def _collapsed(poses: np.ndarray) -> None:
    poses[16:20, :3] = poses[16, :3]


def _giant(poses: np.ndarray) -> None:
    poses[:, :3] *= 2.2


def _dwarf(poses: np.ndarray) -> None:
    poses[:, :3] *= 0.4


def _far(poses: np.ndarray) -> None:
    poses[1:, :3] += (0.3, 0.0, 0.0)


def _infinite(poses: np.ndarray) -> None:
    poses[14, 0] = np.inf


def _turned_by_nothing(poses: np.ndarray) -> None:
    poses[0, 3:] = 0.0


def _other(poses: np.ndarray) -> None:
    poses[:, 1] *= -1.0


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (_stretched, "a bone of the index is 1.02 m"),
        (_collapsed, "a bone of the ring is 0 m"),
        (_giant, "the length of the thumb is 0.22 m"),
        (_dwarf, "the length of the pinky is 0.0268 m"),
        (_far, "the way from the wrist to the middle is 0.398 m"),
        (_infinite, "a joint is infinitely far away"),
        (_turned_by_nothing, "the wrist's quaternion has length 0"),
        (_other, "it is not a right hand"),
    ],
)
def test_what_cannot_be_a_hand_is_told(change: object, told: str) -> None:
    poses = human_hand({})
    assert look(poses) == ""
    change(poses)  # type: ignore[operator]
    assert look(poses) == told


@settings(max_examples=60)
@given(
    arrays(np.float32, (25, 7), elements=st.floats(width=32)),
    st.lists(st.tuples(st.integers(0, 24), st.integers(0, 6)), max_size=3),
)
def test_garbage_is_never_a_hand_that_is_none(garbage: np.ndarray, places: list) -> None:
    with np.errstate(all="ignore"):
        hand = HumanHand(garbage, FINGERS, "right")
        if hand.look() == "":
            assert np.isfinite(hand.vectors).all()
            assert np.isfinite(hand.tips).all()
        poses = human_hand({})
        for joint, part in places:
            poses[joint, part] = garbage[joint, part]
        hand = HumanHand(poses, FINGERS, "right")
        if hand.look() == "":
            assert np.abs(hand.vectors).max() <= 0.2
