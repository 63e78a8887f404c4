"""What a scene says of the ground: kinds of terrain and their figures, for `scene.terrain`.

scene: {terrain: {stairs: {rise: 0.1, run: 0.3}}}
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from unicon_core.errors import PlatformError, alternatives

FLAT = "flat"
_SEED = "seed"


@dataclass(frozen=True)
class Figure:
    """One figure of a kind of terrain.

    Attributes:
        unit: "" for a number without.
        default: what it is unless told; two numbers where it is drawn between them.
        least, most: smallest and largest allowed value.
        says: what it is, for the documents.
    """

    unit: str
    default: float | tuple[float, float]
    least: float
    most: float
    says: str

    @property
    def whole(self) -> bool:
        """Whether it counts something."""
        return isinstance(self.default, int)


_AROUND = {
    "extent": Figure("m", 40.0, 4.0, 200.0, "edge of the square that it covers, the start amid"),
    "flat": Figure("m", 2.0, 1.0, 20.0, "edge of the square around the start that stays flat"),
}
_STEPS = {
    "rise": Figure("m", 0.1, -0.5, 0.5, "height of a step; below 0 they go down first"),
    "run": Figure("m", 0.3, 0.1, 10.0, "depth of a step"),
    "steps": Figure("", 10, 1, 1000, "how many, then a landing"),
}

KINDS: dict[str, dict[str, Figure]] = {
    "slope": {"angle": Figure("rad", 0.1, -0.8, 0.8, "in front of the start; below 0 it falls")},
    "stairs": {**_STEPS, "landing": Figure("m", 1.0, 0.1, 20.0, "before they go the other way")},
    "pyramid": _STEPS,
    "rough": {
        "height": Figure("m", 0.04, 0.0, 1.0, "between the lowest and the highest point"),
        "spacing": Figure("m", 0.1, 0.02, 5.0, "between two points, in x and in y"),
    },
    "patches": {
        "friction": Figure("", (0.2, 1.0), 0.0, 20.0, "factor on that of the floor"),
        "size": Figure("m", 1.0, 0.1, 20.0, "edge of a patch"),
    },
    "obstacles": {
        "height": Figure("m", (0.02, 0.08), 0.0, 2.0, "of a box"),
        "size": Figure("m", (0.2, 0.6), 0.01, 10.0, "of its edges"),
        "density": Figure("1/m²", 0.5, 0.0, 20.0, "boxes on a square metre"),
    },
    "gaps": {
        "width": Figure("m", 0.1, 0.0, 5.0, "of a gap"),
        "run": Figure("m", 0.6, 0.05, 20.0, "of the ground between two"),
        "depth": Figure("m", 0.3, 0.01, 5.0, "of a gap"),
    },
}
"""Kind of terrain to its figures; all have those of `_AROUND`, and those that draw a `seed`."""

DRAWN = ("rough", "patches", "obstacles")
"""Kinds that draw."""


@dataclass(frozen=True)
class Terrain:
    """A kind of terrain with all of its figures.

    Attributes:
        kind: of `KINDS`.
        figures: name to value, or to the lowest and highest one.
        seed: of what is drawn.
    """

    kind: str
    figures: Mapping[str, Any]
    seed: int = 0

    def __getitem__(self, name: str) -> Any:
        return self.figures[name]


def figures_of(kind: str) -> dict[str, Figure]:
    """Return all figures of a kind."""
    return KINDS[kind] | _AROUND


def read_terrain(said: object, seed: int) -> Terrain | None:
    """Return what a scene says of the ground, None for flat.

    Args:
        said: a kind, or a kind to its figures.
        seed: of the scene, for a terrain that names none.

    Raises:
        PlatformError: there is no such kind or figure, or a value is wrong.
    """
    known = (FLAT, *KINDS)
    if isinstance(said, Mapping) and len(said) != 1:
        named = " and ".join(map(str, said)) or "nothing"
        raise PlatformError(f"scene.terrain names {named}; give one of {', '.join(known)}")
    kind, given = next(iter(said.items())) if isinstance(said, Mapping) else (said, None)
    if kind not in known:
        raise PlatformError(
            f"scene.terrain is {str(kind)[:60]!r}; {alternatives(str(kind), known)}; or put other "
            "ground into a model (scene: {model: PATH})"
        )
    given = {} if given is None else given
    if kind == FLAT:
        if given:
            raise PlatformError(f"scene.terrain.flat has no figures; write terrain: {FLAT}")
        return None
    figures = figures_of(kind)
    if not isinstance(given, Mapping):
        name, figure = next(iter(figures.items()))
        raise PlatformError(
            f"scene.terrain.{kind} is {given!r:.60}; write {{{name}: {_written(figure.default)}}}"
        )
    names = (*figures, *([_SEED] if kind in DRAWN else []))
    for name in given:
        if name not in names:
            raise PlatformError(
                f"scene.terrain.{kind} has no {str(name)[:60]!r}; {alternatives(str(name), names)}"
            )
    own = given.get(_SEED, seed)
    if not isinstance(own, int) or isinstance(own, bool) or own < 0:
        raise PlatformError(f"scene.terrain.{kind}: seed is {own!r:.40}; give 0 or more")
    values = {
        name: _value(kind, name, figure, given.get(name, figure.default))
        for name, figure in figures.items()
    }
    if values["flat"] >= values["extent"]:
        raise PlatformError(
            f"scene.terrain.{kind}: flat is {values['flat']:g} m, and extent {values['extent']:g}; "
            "give a larger extent"
        )
    return Terrain(kind, values, own)


def _value(kind: str, name: str, figure: Figure, value: Any) -> Any:
    """Return a value as it is used; a single number for both ends where two are drawn between."""
    pair = isinstance(figure.default, tuple)
    both = value if isinstance(value, (list, tuple)) and pair else (value,) * (1 + pair)
    if len(both) == 1 + pair and all(_fits(figure, each) for each in both):
        if not pair:
            return int(both[0]) if figure.whole else float(both[0])
        low, high = map(float, both)
        if low <= high:
            return low, high
    unit = f" [{figure.unit}]" if figure.unit else ""
    what = "a whole number from " if figure.whole else "[low, high] within " if pair else ""
    raise PlatformError(
        f"scene.terrain.{kind}: {name} is {value!r:.60}; give {what}{figure.least:g} to "
        f"{figure.most:g}{unit}"
    )


def _fits(figure: Figure, value: object) -> bool:
    if not isinstance(value, (int, float)) or isinstance(value, bool):
        return False
    if not math.isfinite(value) or (figure.whole and value != int(value)):
        return False
    return figure.least <= value <= figure.most


def _written(default: float | tuple[float, float]) -> str:
    return str(list(default)) if isinstance(default, tuple) else f"{default:g}"
