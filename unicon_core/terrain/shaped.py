"""Ground that follows from its figures alone: a slope, stairs, a pyramid, gaps."""

from __future__ import annotations

import math
from collections.abc import Iterator

from unicon_core.terrain.ground import THICK, Box, Ground, block
from unicon_core.terrain.words import Terrain

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
