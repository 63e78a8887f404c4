"""The ground that is laid is the one that its figures say, at every point."""

from __future__ import annotations

import hashlib
import math
from typing import Any

import numpy as np
import pytest
from ball_on_ground import laid
from hypothesis import given, settings
from hypothesis import strategies as st

from unicon_core.terrain.ground import BOXES, ground_of, refuse_endless_ground, uniform
from unicon_core.terrain.words import KINDS, Terrain, read_terrain

mujoco = pytest.importorskip("mujoco")

HALF = 5.0  # [m]; extent 10 in what follows


def terrain_of(said: Any) -> Terrain:
    terrain = read_terrain(said, 0)
    assert terrain is not None
    return terrain


def seen(model: Any, x: float, y: float) -> float:
    """Return the height of the ground as a ray from above meets it."""
    data = mujoco.MjData(model)
    data.qpos[0] = 500.0  # the ball is out of the way
    mujoco.mj_forward(model, data)
    way = np.array([0.0, 0.0, -1.0])
    down = mujoco.mj_ray(
        model, data, np.array([x, y, 50.0]), way, None, 1, -1, np.zeros(1, np.int32)
    )
    return 50.0 - float(down)


def walked(terrain: Terrain, x: float) -> int:
    """Return the level of stairs at a way in front of the flat, step by step."""
    level, way = 0, 1
    while x >= 0.0:
        level += way
        if level in (0, terrain["steps"]):
            way, x = -way, x - terrain["landing"]
        else:
            x -= terrain["run"]
    return level


def height_at(terrain: Terrain, x: float, y: float) -> float:
    """Return the height that the figures say."""
    near = terrain["flat"] / 2
    if terrain.kind == "slope":
        return math.tan(terrain["angle"]) * max(0.0, x - near)
    if terrain.kind == "stairs":
        return walked(terrain, x - near) * float(terrain["rise"])
    if terrain.kind == "pyramid":
        out = max(abs(x), abs(y)) - near
        step = math.floor(out / terrain["run"]) + 1 if out >= 0.0 else 0
        return min(step, terrain["steps"]) * float(terrain["rise"])
    assert terrain.kind == "gaps"
    over = (x - near) % (terrain["width"] + terrain["run"])
    return -float(terrain["depth"]) if x > near and over < terrain["width"] else 0.0


FIGURES = {
    "slope": {"angle": st.floats(-0.5, 0.5)},
    "stairs": {
        "rise": st.floats(-0.3, 0.3),
        "run": st.floats(0.2, 1.0),
        "steps": st.integers(1, 6),
        "landing": st.floats(0.5, 2.0),
    },
    "pyramid": {
        "rise": st.floats(-0.3, 0.3),
        "run": st.floats(0.2, 1.0),
        "steps": st.integers(1, 6),
    },
    "gaps": {"width": st.floats(0.05, 0.5), "run": st.floats(0.2, 1.0), "depth": st.floats(0.1, 1)},
}


@pytest.mark.parametrize("kind", FIGURES)
@settings(max_examples=10, deadline=None)
@given(st.data())
def test_a_ray_from_above_meets_the_height_that_is_said(kind: str, data: Any) -> None:
    figures = data.draw(st.fixed_dictionaries(FIGURES[kind]))
    terrain = terrain_of({kind: {"extent": 2 * HALF, **figures}})
    model = laid({kind: {"extent": 2 * HALF, **figures}}, 0.3)
    inside = st.floats(-HALF + 0.01, HALF - 0.01)
    for x, y in data.draw(st.lists(st.tuples(inside, inside), min_size=5, max_size=5)):
        around = [height_at(terrain, x + d, y + e) for d in (-1e-6, 1e-6) for e in (-1e-6, 1e-6)]
        if max(around) - min(around) < 1e-4:  # not on the edge of a step
            assert seen(model, x, y) == pytest.approx(0.3 + around[0], abs=1e-5)


def test_all_kinds_are_flat_around_the_start_and_end_in_a_floor() -> None:
    for kind in KINDS:
        model = laid({kind: {"extent": 10.0, "flat": 2.0}})
        for x, y in ((0, 0), (0.99, 0.99), (-0.99, 0.7), (0.9, -0.99)):
            assert seen(model, x, y) == pytest.approx(0.0, abs=1e-7), kind
        assert seen(model, 30.0, 30.0) <= 0.0
        assert seen(model, 30.0, 30.0) == pytest.approx(ground_of(terrain_of(kind)).floor, abs=5.0)


def test_rough_ground_has_the_heights_that_were_drawn() -> None:
    terrain = terrain_of({"rough": {"extent": 6.0, "spacing": 0.5, "height": 0.2, "seed": 4}})
    field, model = ground_of(terrain).field, laid({"rough": dict(terrain.figures) | {"seed": 4}})
    assert field is not None
    assert field.half == pytest.approx(3.0)
    assert np.abs(field.heights).max() <= 0.1
    assert np.ptp(field.heights) > 0.15
    for row, column in ((1, 1), (3, 11), (6, 6), (11, 2), (10, 8)):
        x, y = -3.0 + 0.5 * column, -3.0 + 0.5 * row
        assert seen(model, x, y) == pytest.approx(field.heights[row, column], abs=1e-6)


def test_no_height_is_flat() -> None:
    field = ground_of(terrain_of({"rough": {"height": 0.0, "extent": 6.0}})).field
    assert field is not None
    assert not field.heights.any()
    assert seen(laid({"rough": {"height": 0.0, "extent": 6.0}}), 2.0, 2.0) == pytest.approx(0.0)
    for said in ({"slope": {"angle": 0}}, {"stairs": {"rise": 0}}, {"gaps": {"width": 0}}):
        assert not ground_of(terrain_of(said)).boxes
    for said in ({"pyramid": {"rise": 0}}, {"obstacles": {"density": 0}}):
        assert not ground_of(terrain_of(said)).boxes


def test_obstacles_stand_beside_the_start_within_their_figures() -> None:
    said = {"obstacles": {"height": [0.05, 0.1], "size": [0.2, 0.4], "density": 2.0, "seed": 1}}
    ground = ground_of(terrain_of(said))
    assert len(ground.boxes) > 3000
    for box in ground.boxes:
        (x, y, z), (a, b, c) = box.centre, box.half
        assert 0.05 <= z + c <= 0.1 + 1e-12
        assert 0.1 <= min(a, b) <= max(a, b) <= 0.2
        assert abs(x) - a >= 1.0 or abs(y) - b >= 1.0
    other = ground_of(terrain_of({"obstacles": said["obstacles"] | {"height": 0.2}}))
    assert [box.centre[:2] for box in other.boxes] == [box.centre[:2] for box in ground.boxes]


def test_the_same_seed_is_the_same_ground_everywhere() -> None:
    digests = []
    for kind in ("rough", "patches", "obstacles"):
        for seed in (0, 0, 1):
            ground = ground_of(terrain_of({kind: {"seed": seed}}))
            field = ground.field
            told = repr(ground.boxes).encode() if field is None else field.heights.tobytes()
            digests.append(hashlib.sha256(told).hexdigest()[:12])
    assert digests[0::3] == digests[1::3]
    assert len({*digests}) == 6
    assert uniform(7, 3).tolist() == [0.625095466604667, 0.8972138009695755, 0.7756856902451935]


@pytest.mark.parametrize("kind", KINDS)
def test_no_more_parts_than_reckoned(kind: str) -> None:
    worst: dict[str, dict[str, float]] = {
        "stairs": {"run": 0.1, "landing": 0.1, "steps": 1},
        "pyramid": {"run": 0.1, "steps": 1000, "rise": 0.01},
        "gaps": {"run": 0.05, "width": 0.01},
        "obstacles": {"density": 3.0},
        "patches": {"size": 0.6},
    }
    terrain = terrain_of({kind: worst.get(kind, {})})
    refuse_endless_ground(terrain)
    assert len(ground_of(terrain).boxes) <= BOXES
