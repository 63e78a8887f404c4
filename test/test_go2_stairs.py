"""The Go2 policy that sees steps: it climbs those at which the blind one stops."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from trainer import trainer

pytest.importorskip("onnxruntime")
pytest.importorskip("mujoco")
ROOT = Path(__file__).resolve().parents[1]
POLICIES = ROOT / "config" / "policies"


@pytest.fixture(scope="module")
def tools() -> Any:
    return trainer("contract", "stairs", "terrain")


@pytest.mark.parametrize(("policy", "climbs"), [("go2_stairs", True), ("go2_velocity", False)])
def test_steps_of_8_cm_are_climbed_by_the_one_that_sees(
    tools: Any, policy: str, climbs: bool
) -> None:
    _, stairs, _ = tools
    climb = stairs.Course(POLICIES / policy, 0.08).climb(0)
    assert climb.climbed == climbs
    assert not climb.fell


def test_training_looks_up_the_heights_of_the_boxes(tools: Any) -> None:
    _, _, terrain = tools
    axis = np.arange(-3.0, 3.0, 0.1) + 0.0125
    points = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1)
    for kind in range(terrain.GROUNDS):
        ground = terrain.random_ground(0.08, kind, np.random.default_rng(kind))
        np.testing.assert_allclose(terrain.raster(ground, axis), terrain.heights(ground, points))
        assert len(ground.boxes) <= terrain.BOXES


def test_x_varies_fastest_in_the_scan(tools: Any) -> None:
    contract, _, _ = tools
    assert contract.SCAN.shape == (187, 2)
    np.testing.assert_allclose(
        contract.SCAN[[0, 1, 16, 17]].T,
        [[-0.8, -0.7, 0.8, -0.8], [-0.5, -0.5, -0.5, -0.4]],
        atol=1e-9,
    )
