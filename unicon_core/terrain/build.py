"""Makes the ground of a terrain, within bounds of memory and time."""

from __future__ import annotations

import math
from collections.abc import Callable

from unicon_core.errors import PlatformError
from unicon_core.terrain.drawn import obstacle_count, obstacles, patches, rough
from unicon_core.terrain.ground import Ground
from unicon_core.terrain.shaped import gaps, pyramid, slope, stairs
from unicon_core.terrain.words import KINDS, Terrain

POINTS = 1_000_000
"""Of a field of heights: 4 MB, and 45 ms to be built."""
BOXES = 5_000
"""As many as a model may have by repetition (`models/bounded.py`)."""

_MAKERS: dict[str, Callable[[Terrain], Ground]] = {
    "slope": slope,
    "stairs": stairs,
    "pyramid": pyramid,
    "rough": rough,
    "patches": patches,
    "obstacles": obstacles,
    "gaps": gaps,
}
assert _MAKERS.keys() == KINDS.keys()


def ground_of(terrain: Terrain) -> Ground:
    """Return the ground of a terrain, the same to the bit for the same figures and seed."""
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
