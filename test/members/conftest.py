"""Robots of several members, for the tests of this folder."""

from __future__ import annotations

from typing import Any

import pytest


@pytest.fixture
def go2_with_hands() -> dict[str, Any]:
    """Robot and platforms of a workflow: a Go2 with two hands."""
    return {
        "robot": {"body": "go2", "left_hand": "inspire_rh56_left", "right_hand": "rohand"},
        "platform": {"body": "fake", "hands": "fake"},
        "rate": 50,
    }
