"""Height map: a grid of ground heights around a robot, measured or received, and what reads it.

States of a height map of n x n cells, rows along y, columns along x of the world:

- `height_map` [m], holes filled as `without_holes` says; NaN where nothing was measured at all.
- `height_map_valid`: 1 where a cell was measured.
- `height_map_centre` [m], `height_map_resolution` [m].
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from unicon_base import StateError
from unicon_base.arrays import Array, Float64
from unicon_core.states import StateSpec

HEIGHT_MAP = "height_map"


def height_map_states(cells: int, resolution: float) -> dict[str, StateSpec]:
    """Return the states of a height map.

    Args:
        cells: along each side.
        resolution: edge of a cell in [m].
    """
    shape, text = (cells, cells), "height of the ground; rows along y, columns along x"
    rows = (
        ("", shape, "float32", "m", (), text, math.nan),
        ("_valid", shape, "int32", "", (), "1 where the height was measured, 0: filled"),
        ("_centre", (2,), "float32", "m", ("x", "y"), "middle of the map", math.nan),
        ("_resolution", (), "float32", "m", (), "edge of a cell", resolution),
    )
    return {
        f"{HEIGHT_MAP}{name}": StateSpec(shape, dtype, unit, "world", *more)
        for name, shape, dtype, unit, *more in rows
    }


class MapHeights:
    """Heights of the cells in which points lie; beyond the map those of its edge.

    Where the middle of the points, which is the robot, is off the map, all are NaN.

    Args:
        states: with the states of a height map of one robot.

    Attributes:
        reads: names of those that are read.

    Raises:
        StateError: the map is one of several robots.
    """

    def __init__(self, states: Any) -> None:
        self.reads = tuple(f"{HEIGHT_MAP}{name}" for name in ("", "_centre", "_resolution"))
        self._map, self._centre, self._step = (states[name] for name in self.reads)
        if self._map.ndim != 2:
            raise StateError("a height map is one robot's; leave num_robots out")
        self._half = np.array(self._map.shape[::-1])[:, None] / 2

    def __call__(self, points: Float64) -> Float64:
        """Return the heights in [m], shape (n,), of points (2, n)."""
        cells = (points - self._centre[:, None]) / self._step + self._half
        if not (np.abs(cells.mean(axis=1) - self._half[:, 0]) <= self._half[:, 0]).all():
            return np.full(points.shape[1], math.nan)
        column, row = np.clip(cells, 0, 2 * self._half - 1).astype(np.intp)
        found: Float64 = self._map[row, column].astype(np.float64)
        return found


class ElevationGrid:
    """Heights of points that were measured; the grid keeps its place in the world as it moves.

    A cell holds the highest point of the newest frame that has points in it.

    Args:
        cells: along each side.
        resolution: edge of a cell in [m].
        decay: what is older counts as not measured, in [s].
        radius: of the robot's body, seen from above, in [m].
    """

    def __init__(self, cells: int, resolution: float, decay: float, radius: float = 0.0) -> None:
        self._step, self._decay = resolution, decay
        self._corner = np.zeros(2, np.int64)
        self._cells = np.full((2, cells, cells), math.nan)  # height, time
        away = (np.arange(cells) - (cells - 1) / 2) * resolution
        self._under = np.hypot(away, away[:, None]) < radius

    def move(self, place: Array) -> None:
        """Go on by whole cells, so that a place x, y in [m] is in the middle."""
        count = self._cells.shape[1]
        corner = np.floor(place / self._step).astype(np.int64) - count // 2
        shift = corner - self._corner
        if not shift.any():
            return
        self._corner = corner
        self._cells = np.roll(self._cells, -shift, (2, 1))
        before = np.arange(count) + shift[:, None]
        beyond_x, beyond_y = (before < 0) | (before >= count)
        self._cells[:, beyond_y] = self._cells[:, :, beyond_x] = math.nan

    def add(self, points: Float64, now: float) -> None:
        """Take a frame.

        Args:
            points: in the world in [m], finite, shape (3, k).
            now: time of it in [s].
        """
        count = self._cells.shape[1]
        cells = np.floor(points[:2] / self._step).astype(np.int64) - self._corner[:, None]
        inside = ((cells >= 0) & (cells < count)).all(axis=0)
        column, row = cells[:, inside]
        highest = np.full((count, count), -math.inf)
        np.maximum.at(highest, (row, column), points[2, inside])
        self._cells[0, row, column] = highest[row, column]
        self._cells[1, row, column] = now

    def measured(self, now: float, under: float = math.nan) -> tuple[Float64, Array, Float64]:
        """Return heights in [m] with holes filled, which cells were measured, and the centre.

        Args:
            now: time in [s].
            under: height of cells below the body that were not measured in [m]; NaN: as others.
        """
        heights, time = self._cells
        valid = now - time <= self._decay
        filled = np.where(valid, heights, np.where(self._under, under, math.nan))
        centre = self._step * (self._corner + np.float64(len(filled) / 2))
        return without_holes(filled), valid, centre


def without_holes(heights: Float64) -> Float64:
    """Return a square map whose holes (NaN) have the mean of their 2 x 2 cells, or a coarser one.

    Where all four are holes, the same is done with the map of such means; and so on.
    """
    holes, count = np.isnan(heights), len(heights)
    if count < 2 or not holes.any():
        return heights
    half = (count + 1) // 2
    padded = np.full((2 * half, 2 * half), math.nan)
    padded[:count, :count] = heights
    fours = padded.reshape(half, 2, half, 2)
    with np.errstate(invalid="ignore"):
        means = np.nansum(fours, (1, 3)) / np.isfinite(fours).sum((1, 3))
    coarse = without_holes(means).repeat(2, 0).repeat(2, 1)
    return np.where(holes, coarse[:count, :count], heights)
