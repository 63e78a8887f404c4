"""Known joints come back of human hands that are copies of the robot's, of any size."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hands import HANDS

from benchmarks.retarget import copied_hand, smooth_motion
from unicon_manipulation.retarget.hand_model import HandModel, HumanHand
from unicon_manipulation.retargeting_block import Retargeting

Build = Callable[[str], HandModel]


def followed(model: HandModel, motion: np.ndarray, size: float, anew: bool) -> np.ndarray:
    """Return the joints that are found for copies of the robot's hand, shape (ticks, n)."""
    retargeting, poses = Retargeting(model, 0.0), np.zeros((25, 7), np.float32)
    hand = HumanHand(poses, model.fingers)
    found = []
    for tick, q in enumerate(motion):
        poses[...] = copied_hand(model, q)
        poses[:, :3] *= size
        assert hand.look() == ""
        scale = np.full(len(model.fingers), 1.0 / size)
        retargeting.solve(hand, scale, anew=anew or tick == 0)
        assert (retargeting.q >= model.lower).all()
        assert (retargeting.q <= model.upper).all()
        found.append(retargeting.q.copy())
    return np.array(found)


@pytest.mark.parametrize("name", HANDS)
def test_of_a_smooth_motion_through_all_joints(hand_model: Build, name: str) -> None:
    model = hand_model(name)
    motion = smooth_motion(model, 250, 50.0, seed=1)
    wrong = np.abs(followed(model, motion, 0.8, anew=False) - motion).max(axis=1)
    assert np.percentile(wrong, 99) <= 0.01


@pytest.mark.parametrize("name", HANDS)
def test_of_hands_that_come_one_by_one(hand_model: Build, name: str) -> None:
    model = hand_model(name)
    motion = np.random.default_rng(2).uniform(model.lower, model.upper, (100, len(model.lower)))
    wrong = np.abs(followed(model, motion, 1.2, anew=True) - motion).max(axis=1)
    assert np.percentile(wrong, 99) <= 0.01
