"""Ground: a terrain as shapes in the world, for platforms, which lay it under a robot.

The robot begins at the origin, where the ground is flat at height 0; x points forward. A slope,
stairs, a pyramid and gaps follow from their figures alone; rough ground, patches and obstacles are
drawn, the same on every machine. All within bounds of memory and time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from unicon_base import PlatformError
from unicon_base.arrays import Float64
from unicon_core.terrain.words import KINDS, Terrain

THICK = 0.5
"""How far shapes go down below the lowest ground, [m]: a foot at 40 m/s goes 8 cm in a step."""


@dataclass(frozen=True)
class Box:
    """A box that stands still.

    Attributes:
        centre: in the world in [m].
        half: half of its edges in [m].
        pitch: by which it is turned about y in [rad]; its front goes down.
        friction: factor on that of the floor.
    """

    centre: tuple[float, float, float]
    half: tuple[float, float, float]
    pitch: float = 0.0
    friction: float = 1.0

    @property
    def quat(self) -> tuple[float, float, float, float]:
        """Box to world, wxyz."""
        return math.cos(self.pitch / 2), 0.0, math.sin(self.pitch / 2), 0.0


@dataclass(frozen=True, eq=False)
class Field:
    """Heights at the points of a grid; between them the ground is made of triangles.

    Attributes:
        heights: in [m], shape (points in y, points in x).
        half: from the middle to the edge in [m].
    """

    heights: Float64
    half: float


@dataclass(frozen=True, eq=False)
class Ground:
    """What a terrain is made of.

    Attributes:
        floor: height of the floor below and beyond all of it in [m].
        boxes: that lie on it.
        field: or heights over it.
    """

    floor: float
    boxes: tuple[Box, ...] = ()
    field: Field | None = None


def block(
    x: tuple[float, float], y: tuple[float, float], top: float, floor: float, friction: float = 1.0
) -> Box:
    """Return an upright box by its ends in x and y and its top, down below the floor, in [m]."""
    bottom = min(floor, top) - THICK
    return Box(
        ((x[0] + x[1]) / 2, (y[0] + y[1]) / 2, (top + bottom) / 2),
        ((x[1] - x[0]) / 2, (y[1] - y[0]) / 2, (top - bottom) / 2),
        friction=friction,
    )


Strip = tuple[float, float, float]
"""From, to and height in [m]."""

_NONE = 1e-6  # [m]; what rounding leaves at the edge is not a step


def slope(terrain: Terrain) -> Ground:
    """Return a plane that rises or falls in front of the start, for all y."""
    angle, half, near = terrain["angle"], terrain["extent"] / 2, terrain["flat"] / 2
    if not angle:
        return Ground(0.0)
    length, rise = (half - near) / math.cos(angle), (half - near) * math.tan(angle)
    floor, thick = min(0.0, rise), 2.0 * THICK
    # The middle of the box lies half its thickness below the middle of the slope.
    x = (near + half) / 2 + math.sin(angle) * thick / 2
    z = rise / 2 - math.cos(angle) * thick / 2
    boxes = [Box((x, 0.0, z), (length / 2, half, thick / 2), pitch=-angle)]
    if floor < 0.0:
        boxes.append(block((-half, near), (-half, half), 0.0, floor))
    return Ground(floor, tuple(boxes))


def stairs(terrain: Terrain) -> Ground:
    """Return flights of stairs in front of the start, up, a landing, down, and so on, for all y."""
    half, near = terrain["extent"] / 2, terrain["flat"] / 2
    strips: list[Strip] = [(-half, near, 0.0)]
    for start, end, level in _levels(terrain, near, half):
        strips.append((start, end, level * terrain["rise"]))
    return _strips(strips, half)


def _levels(terrain: Terrain, near: float, half: float) -> Iterator[tuple[float, float, int]]:
    """Yield from, to and number of rises of all that is level, until the edge."""
    steps, run, landing = terrain["steps"], terrain["run"], terrain["landing"]
    x, level, way = near, 0, 1
    while x < half - _NONE:
        level += way
        turns = level in (0, steps)
        end = min(x + (landing if turns else run), half)
        yield x, end, level
        x, way = end, -way if turns else way


def gaps(terrain: Terrain) -> Ground:
    """Return ground with gaps across it in front of the start."""
    half, near, width = terrain["extent"] / 2, terrain["flat"] / 2, terrain["width"]
    if not width:
        return Ground(0.0)
    strips, x = [(-half, near, 0.0)], near + width
    while x < half - _NONE:
        end = min(x + terrain["run"], half)
        strips.append((x, end, 0.0))
        x = end + width
    return _strips(strips, half, -terrain["depth"])


def _strips(strips: list[Strip], half: float, floor: float = 0.0) -> Ground:
    """Return strips across the way; what is as low as the floor is the floor."""
    floor = min(floor, *(top for _, _, top in strips))
    boxes = [
        block((start, end), (-half, half), top, floor) for start, end, top in strips if top > floor
    ]
    return Ground(floor, tuple(boxes))


def pyramid(terrain: Terrain) -> Ground:
    """Return steps on all four sides of the start: out of a pit, or down from a top."""
    half, near, rise = terrain["extent"] / 2, terrain["flat"] / 2, terrain["rise"]
    edges = [near + k * terrain["run"] for k in range(terrain["steps"])]
    edges = [edge for edge in edges if edge < half - _NONE]
    if rise < 0.0:  # one upon the other
        floor = rise * len(edges)
        tops = [(edge, rise * k) for k, edge in enumerate(edges)]
        return Ground(
            floor, tuple(block((-e, e), (-e, e), top, floor) for e, top in tops if top > floor)
        )
    boxes: list[Box] = []
    if rise > 0.0:
        for k, (inner, outer) in enumerate(zip(edges, [*edges[1:], half]), 1):
            boxes += _ring(inner, outer, rise * k)
    return Ground(0.0, tuple(boxes))


def _ring(inner: float, outer: float, top: float) -> list[Box]:
    """Return the four boxes between two squares around the origin."""
    ends = ((-outer, -inner), (inner, outer))
    return [
        *(block(end, (-outer, outer), top, 0.0) for end in ends),
        *(block((-inner, inner), end, top, 0.0) for end in ends),
    ]


BELOW = 0.02
"""From the lowest ground to the floor in [m], so that nothing touches both."""


def uniform(seed: int, *shape: int) -> Float64:
    """Return numbers from 0 up to 1, bit-exact in every version of NumPy.

    What PCG64 gives is promised to stay (NEP 19), what `Generator` makes of it is not: the upper 53
    of each 64 bits, as a fraction.
    """
    raw = np.random.PCG64(seed).random_raw(int(np.prod(shape)))
    numbers = (raw >> np.uint64(11)).astype(np.float64) * 2.0**-53
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


POINTS = 1_000_000
"""Of a field of heights: 4 MB, and 45 ms to be built."""
BOXES = 5_000
"""As many as a model may have by repetition (`models/bounded.py`)."""

_MAKERS: dict[str, Callable[[Terrain], Ground]] = {
    make.__name__: make for make in (slope, stairs, pyramid, rough, patches, obstacles, gaps)
}
assert _MAKERS.keys() == KINDS.keys()


def ground_of(terrain: Terrain) -> Ground:
    """Return the ground of a terrain, bit-exact for the same figures and seed."""
    return _MAKERS[terrain.kind](terrain)


def refuse_endless_ground(terrain: Terrain) -> None:
    """Refuse a terrain of too many parts, before any is made.

    Raises:
        PlatformError: with the figures that make them so many.
    """
    count, most, what, by = _parts(terrain)
    if count > most:
        raise PlatformError(
            f"scene.terrain.{terrain.kind}: an extent of {terrain['extent']:g} m with {by} "
            f"{_said(terrain[by])} makes {count} {what}, at most {most}; give a smaller extent or "
            f"another {by}"
        )


def _parts(terrain: Terrain) -> tuple[int, int, str, str]:
    """Return how many parts there are at most, how many may be, what they are and what says so."""
    extent, kind = terrain["extent"], terrain.kind
    if kind == "rough":
        return round(extent / terrain["spacing"] + 1) ** 2, POINTS, "points", "spacing"
    if kind == "patches":
        return math.ceil(extent / terrain["size"]) ** 2, BOXES, "patches", "size"
    if kind == "obstacles":
        return obstacle_count(terrain), BOXES, "obstacles", "density"
    if kind == "slope":
        return 2, BOXES, "boxes", "angle"
    run = terrain["run"] + terrain.figures.get("width", 0.0)
    sides = 4 if kind == "pyramid" else 1  # rings all around
    return math.ceil(extent / 2 / run) * sides, BOXES, "boxes", "run"


def _said(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
