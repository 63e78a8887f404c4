"""Heights of ground are those of vertical rays on what MuJoCo makes of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ball_on_ground import BALL, NOTHING, laid

from unicon_base.errors import ModelError
from unicon_core.models.loaded import LoadedModel
from unicon_core.models.terrain import NO_GROUND, RayHeights, SceneGround
from unicon_core.terrain.words import read_terrain

mujoco = pytest.importorskip("mujoco")

GRID = np.stack(np.meshgrid(np.linspace(-0.8, 0.8, 17), np.linspace(-0.5, 0.5, 11))).reshape(2, -1)
THERE = GRID + np.array([[2.6], [0.1]])
GROUNDS = [
    {"stairs": {}},
    {"stairs": {"rise": -0.13, "run": 0.25}},
    {"pyramid": {}},
    {"pyramid": {"rise": -0.2}},
    {"rough": {"height": 0.3, "extent": 20.0}},
    {"slope": {"angle": 0.3}},
    {"slope": {"angle": -0.7, "extent": 6.0}},
    {"obstacles": {"extent": 20.0}},
    {"patches": {"extent": 10.0}},
    {"gaps": {}},
]


def model_of(height: float = 0.0, **text: str) -> LoadedModel:
    """Return the ball on its floor and what is given beside it."""
    xml = BALL.format(height=height, **{**NOTHING, **text})
    model = mujoco.MjModel.from_xml_string(xml)
    lid = [i for i in range(model.njnt) if model.joint(i).name == "lid"]
    return LoadedModel(model, Path("ball.xml"), lid)


def by_rays(model: Any, points: np.ndarray) -> np.ndarray:
    """Return the heights by a vertical ray for each point, the ball left out."""
    data = mujoco.MjData(model)
    data.qpos[:3] = 0.0, 0.0, 500.0
    mujoco.mj_forward(model, data)
    down, geom = np.array([0.0, 0.0, -1.0]), np.zeros(1, np.int32)
    found = []
    for x, y in points.T:
        far = mujoco.mj_ray(model, data, np.array([x, y, 50.0]), down, None, True, -1, geom)
        found.append(50.0 - far if geom[0] >= 0 else NO_GROUND)
    return np.array(found)


def places() -> list[np.ndarray]:
    """Return scans at random poses: near the start, on the ground, and over its edge."""
    random = np.random.default_rng(3)
    found = []
    for k in range(9):
        angle, middle = random.uniform(-3, 3), random.uniform(-1, 1, 2) * (3.0, 10.0, 21.0)[k % 3]
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        found.append(turn @ GRID + middle[:, None])
    return found


@pytest.mark.parametrize("said", GROUNDS, ids=str)
def test_heights_are_those_of_vertical_rays(said: Any) -> None:
    height = 0.4
    model = laid(said, height)
    ground = SceneGround(model_of(height), read_terrain(said, 0))
    rays = RayHeights(LoadedModel(model, Path("ball.xml"), model_of().joints))
    for points in places():
        exact = by_rays(model, points)
        # MuJoCo keeps a field's heights as float32: 1e-8 of their range.
        np.testing.assert_allclose(ground(points), exact, atol=2e-8)
        # Rays lean by height · radius / 1e6, which a slope of 40° turns into height.
        np.testing.assert_allclose(rays(points), exact, atol=2e-5)


BOX = '<geom type="box" size="1 1 0.25" pos="2 0 0.25" euler="0 12 30" {}/>'
SEEN = '<geom type="sphere" size="0.3" pos="2 0 2" contype="0" conaffinity="0"/>'


@pytest.mark.parametrize("how", ["", 'rgba="1 1 1 0"'], ids=["seen", "invisible"])
def test_other_surroundings_are_met_by_rays(how: str) -> None:
    """What cannot be touched is no ground, what is not seen is."""
    ground = SceneGround(model_of(around=BOX.format(how) + SEEN), None)
    exact = by_rays(model_of(around=BOX.format("")).model, THERE)
    assert exact.max() > 0.5 > 0.1 > exact.min()
    np.testing.assert_allclose(ground(THERE), exact, atol=1e-5)


def test_where_there_is_no_ground_it_is_far_below() -> None:
    loaded = model_of(open="<!--", close="-->", around=BOX.format(""))
    heights = SceneGround(loaded, None)(np.array([[2.0, 20.0], [0.0, 0.0]]))
    assert heights[0] > 0.4
    assert heights[1] == NO_GROUND


def test_terrain_needs_a_level_floor_and_can_be_exchanged() -> None:
    ground = SceneGround(model_of(0.4), read_terrain({"stairs": {"rise": 0.1}}, 0))
    ahead = np.array([[1.15], [0.0]])
    assert ground(ahead) == pytest.approx([0.5])
    ground.lay(None)
    assert ground(ahead) == pytest.approx([0.4])
    with pytest.raises(ModelError, match="surroundings of its own"):
        SceneGround(model_of(around=BOX.format("")), read_terrain("stairs", 0))
