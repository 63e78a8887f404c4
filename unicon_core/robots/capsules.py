"""Capsules: what a robot's links are to whoever keeps them apart, of robot files.

capsules:
  left_forearm: {body: left_elbow_link, from: [0.02, 0.0, 0.0], to: [0.18, 0.0, 0.0], radius: 0.05}
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from unicon_core.errors import alternatives
from unicon_core.robots.places import wrong_numbers

CAPSULE_KEYS = ("body", "from", "to", "radius")

_EXAMPLE = (
    "write {left_forearm: {body: left_elbow_link, from: [x, y, z], to: [x, y, z], radius: 0.05}}"
)
_THICKEST = 1.0  # [m]

_Point = tuple[float, float, float]


@dataclass(frozen=True)
class Capsule:
    """All points within a radius of a segment; one of length 0 is a sphere."""

    body: str
    """Body of the model that carries it."""
    start: _Point
    """Of the segment, in the frame of that body in [m]."""
    end: _Point
    """Likewise."""
    radius: float
    """In [m]."""


def capsules_of(said: Mapping[str, Mapping[str, Any]]) -> dict[str, Capsule]:
    """Return the capsules that a checked mapping says, by the names that it gives them."""
    found = {}
    for name, capsule in said.items():
        x, y, z = map(float, capsule["from"])
        ex, ey, ez = map(float, capsule.get("to", capsule["from"]))
        found[name] = Capsule(capsule["body"], (x, y, z), (ex, ey, ez), float(capsule["radius"]))
    return found


def wrong_capsules(said: object) -> Iterator[tuple[tuple[str, ...], str]]:
    """Yield what is wrong with capsules: keys that lead to it, and the words behind them.

    Args:
        said: name to `body`, `from` and `to` [m] (as `from` where it is left out), `radius` [m].
    """
    if not isinstance(said, Mapping):
        yield (), f"is {said!r:.60}; {_EXAMPLE}"
        return
    for name, capsule in said.items():
        if not isinstance(name, str) or not isinstance(capsule, Mapping):
            yield (str(name),), f"is {capsule!r:.60}; {_EXAMPLE}"
            continue
        for key in capsule:
            if key not in CAPSULE_KEYS:
                yield (name, str(key)), f"is not known; {alternatives(str(key), CAPSULE_KEYS)}"
        for key in ("body", "from", "radius"):
            if key not in capsule:
                yield (name,), f"has no {key!r}; {_EXAMPLE}"
        body = capsule.get("body", "-")
        if not isinstance(body, str) or not body.strip():
            yield (name, "body"), f"is {body!r:.60}; write a body of the model"
        for key in ("from", "to"):
            if key in capsule and (wrong := wrong_numbers(key, capsule[key], 3)):
                yield (name, key), wrong
        radius = capsule.get("radius", 0.1)
        number = isinstance(radius, (int, float)) and not isinstance(radius, bool)
        if not number or not math.isfinite(radius) or not 0.0 < radius <= _THICKEST:
            yield (name, "radius"), f"is {radius!r:.60}; write [m] above 0, at most {_THICKEST:g}"
