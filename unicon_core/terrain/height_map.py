"""Heights of the ground at given points: of known ground, and of a map that was measured.

`GroundHeights` needs no simulator, so that every simulator that lays a ground has the same heights
under a scan.

States of a height map of n x n cells, rows along y, columns along x of the world:

- `height_map` [m], holes filled as `without_holes` says; NaN where nothing was measured at all.
- `height_map_valid`: 1 where a cell was measured.
- `height_map_centre` [m], `height_map_resolution` [m].
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from unicon_base import StateError
from unicon_base.arrays import Array, Float64
from unicon_core.states import StateSpec
from unicon_core.terrain.ground import Box, Field, Ground

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


Heights = Callable[[Float64], Float64]
"""Takes x and y in the world in [m], shape (2, n); returns the ground's heights in [m], (n,)."""


class GroundHeights:
    """The height of the ground, exact but for rounding.

    Args:
        ground: boxes, or a field of heights.
        height: of the model's own floor in [m], on which the ground is laid.
    """

    def __init__(self, ground: Ground, height: float = 0.0) -> None:
        self._floor = ground.floor + height
        self._height, self._field = height, ground.field
        rows = np.array([_faces(box) for box in ground.boxes], np.float64).reshape(-1, 8)
        self._middle, self._half = rows[:, :2], rows[:, 2:4]
        # Two upper faces of each box: z = slope · (x − middle) + top.
        self._slopes, self._tops = rows[:, 4:6], rows[:, 6:] + height

    def __call__(self, points: Float64) -> Float64:
        """Return the heights in [m], shape (n,).

        Args:
            points: x and y in the world in [m], finite, shape (2, n).
        """
        if self._field is not None:
            return self._of_field(self._field, points)
        if not len(self._middle):
            return np.full(points.shape[1], self._floor)
        low, high = points.min(axis=1), points.max(axis=1)
        beside = np.abs(self._middle - (low + high) / 2) <= self._half + (high - low) / 2
        chosen = np.flatnonzero(beside[:, 0] & beside[:, 1])
        away = points - self._middle[chosen, :, None]
        inside = (np.abs(away) <= self._half[chosen, :, None]).all(axis=1)
        tops = self._tops[chosen, :, None] + self._slopes[chosen, :, None] * away[:, :1]
        found: Float64 = np.where(inside, tops.min(axis=1), self._floor).max(
            axis=0, initial=self._floor
        )
        return found

    def _of_field(self, field: Field, points: Float64) -> Float64:
        """Return the heights of the triangles, each half a cell, cut from its lowest x and y."""
        columns, flat = field.heights.shape[1], field.heights.reshape(-1)
        cells = (points + field.half) * ((columns - 1) / (2.0 * field.half))
        first = np.clip(cells.astype(np.intp), 0, columns - 2)
        x, y = cells - first
        corner = first[1] * columns + first[0]
        low = flat.take(corner)
        side = flat.take(corner + np.where(x >= y, 1, columns))
        high = flat.take(corner + columns + 1)
        found = low + np.maximum(x, y) * (side - low) + np.minimum(x, y) * (high - side)
        beyond = (np.abs(points) > field.half).any(axis=0)
        return np.where(beyond, self._floor, found + self._height)


def _faces(box: Box) -> tuple[float, ...]:
    """Return middle and half of what a box covers, and slopes and tops of its two upper faces."""
    (x, y, z), (length, width, thick) = box.centre, box.half
    if not box.pitch:
        return x, y, length, width, 0.0, 0.0, z + thick, z + thick
    sine, cosine = math.sin(box.pitch), math.cos(box.pitch)
    return (
        *(x, y, length * cosine + thick * abs(sine), width),
        *(-sine / cosine, cosine / sine, z + thick / cosine, z + length / abs(sine)),
    )
