"""Ground that is drawn: rough, of patches, with obstacles; the same on every machine."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from unicon_core.terrain.ground import Box, Field, Ground, block
from unicon_core.terrain.words import Terrain

Float = NDArray[np.float64]

BELOW = 0.02
"""From the lowest ground to the floor in [m], so that nothing touches both."""


def uniform(seed: int, *shape: int) -> Float:
    """Return numbers from 0 up to 1, the same to the bit in every version of NumPy.

    What PCG64 gives is promised to stay (NEP 19), what `Generator` makes of it is not: the upper 53
    of each 64 bits, as a fraction.
    """
    raw = np.random.PCG64(seed).random_raw(int(np.prod(shape)))
    numbers: Float = (raw >> np.uint64(11)).astype(np.float64) * 2.0**-53
    return numbers.reshape(shape)


def rough(terrain: Terrain) -> Ground:
    """Return a field of heights, each drawn by itself; 0 around the start."""
    half, spacing, height = terrain["extent"] / 2, terrain["spacing"], terrain["height"]
    count = max(round(half / spacing), 1)
    at = np.arange(-count, count + 1) * spacing
    heights = height * (uniform(terrain.seed, len(at), len(at)) - 0.5)
    near = np.abs(at) < terrain["flat"] / 2 + spacing * (1.0 - 1e-6)  # all cells of the square
    heights[np.ix_(near, near)] = 0.0
    return Ground(float(heights.min()) - BELOW, field=Field(heights, count * spacing))


def patches(terrain: Terrain) -> Ground:
    """Return tiles of one height, each with a friction of its own; that of the floor at the start.

    Their edges are multiples of `size` from the start, or as near as the extent allows.
    """
    half, size = terrain["extent"] / 2, terrain["size"]
    count = max(round(half / size), 1)
    low, high = terrain["friction"]
    factors = low + (high - low) * uniform(terrain.seed, 2 * count, 2 * count)
    edges = np.arange(-count, count + 1) * size
    beside = (edges[1:] <= -terrain["flat"] / 2) | (edges[:-1] >= terrain["flat"] / 2)
    boxes = []
    for row, y in enumerate(zip(edges.tolist(), edges[1:].tolist())):
        for column, x in enumerate(zip(edges.tolist(), edges[1:].tolist())):
            far = beside[row] or beside[column]
            friction = float(factors[row, column]) if far else 1.0
            boxes.append(block(x, y, 0.0, -BELOW, friction))
    return Ground(-BELOW, tuple(boxes))


def obstacles(terrain: Terrain) -> Ground:
    """Return boxes on the floor, in any place but around the start.

    Each takes five numbers, so that other figures change no place.
    """
    half, near = terrain["extent"] / 2, terrain["flat"] / 2
    boxes: list[Box] = []
    for x, y, wide, deep, high in uniform(terrain.seed, obstacle_count(terrain), 5).tolist():
        x, y = half * (2.0 * x - 1.0), half * (2.0 * y - 1.0)
        wide, deep = (_between(terrain["size"], u) / 2 for u in (wide, deep))
        top = _between(terrain["height"], high)
        if top > 0.0 and (abs(x) - wide >= near or abs(y) - deep >= near):
            boxes.append(block((x - wide, x + wide), (y - deep, y + deep), top, 0.0))
    return Ground(0.0, tuple(boxes))


def obstacle_count(terrain: Terrain) -> int:
    """Return how many obstacles are drawn."""
    density: float = terrain["density"]
    edge: float = terrain["extent"]
    return round(density * edge * edge)


def _between(ends: tuple[float, float], u: float) -> float:
    return ends[0] + (ends[1] - ends[0]) * u
