"""An arm of six joints on a turned base, and both arms of a G1."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from welder import Solved, write_arm

from unicon_core.robots import Robot, load_robot


@pytest.fixture
def arm_file(tmp_path: Path) -> Path:
    return write_arm(tmp_path)


@pytest.fixture
def arm(arm_file: Path) -> Robot:
    return load_robot(arm_file)


@pytest.fixture
def g1(assets: Path) -> Robot:
    """A G1 with 29 joints, whose model is one of the assets."""
    return load_robot("g1_29dof")


@pytest.fixture
def solved() -> Callable[..., Solved]:
    """Builds inverse kinematics of a robot."""
    return Solved
