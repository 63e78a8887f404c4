"""GroundHeights: how high a ground is at given points, from its boxes and its field alone.

It needs no simulator, so that every simulator that lays a ground has the same heights under a scan.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from unicon_base.arrays import Float64
from unicon_core.terrain.ground import Box, Field, Ground

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
