"""An optional twin: mink, with the same model and weights, brings hands to the same places."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from unicon_core.robots import Robot

pytest.importorskip("daqp", reason="daqp is not installed: pip install 'unicon_ros[ik]'")
pytest.importorskip("mink", reason="mink is not installed: pip install mink")

HANDS = ("left_hand", "right_hand")


def test_mink_brings_hands_to_the_same_places(g1: Robot, solved: Callable[..., Any]) -> None:
    from benchmarks.reach import PERIOD, MinkArms

    it = solved(g1, HANDS, ("arms",), apart=0.0)
    assert it.period == PERIOD
    twin = MinkArms(g1, it.rate)
    homes = [it.at(it.pose[it.moved], i) for i in range(2)]
    for tick in range(150):
        angle = 0.05 * tick
        targets = [
            ((x, y + 0.08 * math.sin(angle), z + 0.1 + 0.08 * math.cos(angle)), quat)
            for (x, y, z), quat in homes
        ]
        it.tick(*targets)
        twin(targets)
        if tick > 30:
            ours = [it.at(it.ik.pos, i) for i in range(2)]
            theirs = [it.at(twin.pos, i) for i in range(2)]
            for (place, quat), (its, other) in zip(ours, theirs):
                np.testing.assert_allclose(place, its, atol=1e-3)
                assert abs(np.dot(quat, other)) > 1.0 - 1e-5
