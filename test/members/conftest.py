"""Robots of several members, for the tests of this folder."""

from __future__ import annotations

import pytest


@pytest.fixture
def go2_with_hands():
    """Robot and platforms of a workflow: a Go2 with two hands."""
    return {
        "robot": {"body": "go2", "left_hand": "inspire_rh56_left", "right_hand": "rohand"},
        "platform": {"body": "fake", "hands": "fake"},
        "rate": 50,
    }
