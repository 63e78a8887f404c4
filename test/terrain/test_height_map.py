"""A height map keeps its place as it moves, fills holes by its rule, and is read cell by cell."""

from __future__ import annotations

import numpy as np
import pytest

from unicon_base.errors import StateError
from unicon_core.states import States
from unicon_core.terrain.height_map import ElevationGrid, MapHeights, height_map_states

STEP, CELLS = 0.1, 12


class SlowGrid:
    """The same, with a dictionary of cells of the world."""

    def __init__(self) -> None:
        self.cells: dict[tuple[int, int], tuple[float, float]] = {}
        self.corner = (0, 0)

    def move(self, x: float, y: float) -> None:
        self.corner = tuple(int(np.floor(v / STEP)) - CELLS // 2 for v in (x, y))  # type: ignore[assignment]
        self.cells = {key: cell for key, cell in self.cells.items() if self.inside(key)}

    def inside(self, key: tuple[int, int]) -> bool:
        return all(0 <= k - c < CELLS for k, c in zip(key, self.corner))

    def add(self, points: np.ndarray, now: float) -> None:
        frame: dict[tuple[int, int], float] = {}
        for x, y, z in points.T:
            key = int(np.floor(x / STEP)), int(np.floor(y / STEP))
            if self.inside(key):
                frame[key] = max(z, frame.get(key, -np.inf))
        self.cells |= {key: (z, now) for key, z in frame.items()}

    def heights(self, now: float, decay: float) -> np.ndarray:
        found = np.full((CELLS, CELLS), np.nan)
        for (i, j), (z, then) in self.cells.items():
            if now - then <= decay:
                found[j - self.corner[1], i - self.corner[0]] = z
        return found


def filled(heights: np.ndarray) -> np.ndarray:
    """Fill holes cell by cell, as the rule is written."""
    levels = [heights]
    while len(levels[-1]) > 1:
        fine = levels[-1]
        half = (len(fine) + 1) // 2
        coarse = np.full((half, half), np.nan)
        for i, j in np.ndindex(half, half):
            four = fine[2 * i : 2 * i + 2, 2 * j : 2 * j + 2]
            if not np.isnan(four).all():
                coarse[i, j] = np.nanmean(four)
        levels.append(coarse)
    out = heights.copy()
    for row, column in np.argwhere(np.isnan(heights)):
        values = (level[row >> k, column >> k] for k, level in enumerate(levels))
        out[row, column] = next((value for value in values if not np.isnan(value)), np.nan)
    return out


@pytest.mark.parametrize("seed", range(5))
def test_a_grid_is_that_of_a_slow_one(seed: int) -> None:
    random = np.random.default_rng(seed)
    fast, slow, place = ElevationGrid(CELLS, STEP, 3.0), SlowGrid(), np.zeros(2)
    for now in range(20):
        place += random.normal(size=2) * (5.0 if now == 12 else 0.15)  # once it is far away
        points = np.vstack((place[:, None] + random.normal(size=(2, 30)) * 0.5, random.random(30)))
        for each in (fast.move(place), slow.move(*place)):
            assert each is None
        fast.add(points, float(now))
        slow.add(points, float(now))
        heights, valid, centre = fast.measured(float(now))
        exact = slow.heights(now, 3.0)
        assert np.array_equal(valid, ~np.isnan(exact))
        assert np.array_equal(heights[valid], exact[valid])
        np.testing.assert_allclose(heights, filled(exact), atol=1e-12)
        assert np.abs(centre - place).max() <= STEP


def test_what_was_never_measured_is_marked() -> None:
    grid = ElevationGrid(CELLS, STEP, 3.0, radius=0.35)
    grid.move(np.zeros(2))
    assert np.isnan(grid.measured(0.0)[0]).all()
    grid.add(np.array([[0.05, 0.55], [0.05, 0.05], [0.2, 0.3]]), 0.0)
    heights, valid, _ = grid.measured(1.0, under=-0.3)
    assert valid.sum() == 2
    assert heights[6, 6] == 0.2  # a measured cell under the body stays
    assert heights[6, 7] == heights[5, 4] == -0.3
    assert not grid.measured(3.5)[1].any()


def test_points_are_read_from_their_cells_and_the_edge() -> None:
    states = States(height_map_states(4, 0.5))
    states["height_map"][...] = np.arange(16).reshape(4, 4)
    states["height_map_centre"][...] = 10.0, -3.0
    read = MapHeights(states)
    # The map is from 9 to 11 in x, from -4 to -2 in y.
    points = np.array([[9.1, 10.9, 9.6, 8.0, 12.4], [-3.9, -2.1, -2.6, -3.9, -2.1]])
    assert read(points).tolist() == [0.0, 15.0, 9.0, 0.0, 15.0]
    assert np.isnan(read(points + np.array([[3.0], [0.0]]))).all()  # the robot is off it
    states["height_map_centre"][0] = np.nan  # nothing has come yet
    assert np.isnan(read(points)).all()
    with pytest.raises(StateError, match="one robot's"):
        MapHeights(States(height_map_states(4, 0.5), 2))
