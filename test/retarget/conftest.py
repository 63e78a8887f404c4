"""Robot hands, with the vendors' models where the assets are, else with models of our own."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from hands import rohand_model, xhand_model

from unicon_core.robots import load_robot
from unicon_manipulation.retarget.hand_model import HandModel

OWN = {"xhand1": xhand_model, "rohand": rohand_model}


@pytest.fixture
def hand_model(request: pytest.FixtureRequest, tmp_path: Path) -> Callable[[str], HandModel]:
    """Builds the model of a hand by the robot's name; of ROHand with the side behind it."""
    pytest.importorskip("mujoco")

    def build(name: str) -> HandModel:
        kind, _, side = name.rpartition("_")
        if kind not in OWN:
            request.getfixturevalue("assets")
            return HandModel(load_robot(name))
        robot = load_robot(kind if kind == "rohand" else name)
        return HandModel(robot, side, str(OWN[kind](tmp_path, side)))

    return build
