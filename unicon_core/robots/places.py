"""Places on a body: where it carries its hands, and what it reaches with, for robot files.

mounts:
  dex3_left: {body: left_wrist_yaw_link, position: [0.0415, 0.003, 0.0], quat: [1, 0, 0, 0]}
end_effectors:
  left_hand: {body: left_wrist_yaw_link, position: [0.12, 0.0, 0.0]}
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from unicon_core.errors import alternatives

PLACE_KEYS = ("body", "position", "quat")

_EXAMPLE = "write {left_hand: {body: left_wrist_yaw_link, position: [x, y, z], quat: [w, x, y, z]}}"
_FARTHEST = 10.0  # [m]; no robot is larger


@dataclass(frozen=True)
class Place:
    """A frame that is fixed to a body of the robot's model."""

    body: str
    """Body of the model that carries it."""
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """In the frame of that body in [m]."""
    quat: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    """Rotation of the frame to that body, unit quaternion wxyz."""


def places_of(said: Mapping[str, Mapping[str, Any]]) -> dict[str, Place]:
    """Return the places that a checked mapping says, by the names that it gives them."""
    found = {}
    for name, place in said.items():
        x, y, z = map(float, place.get("position", (0.0, 0.0, 0.0)))
        qw, qx, qy, qz = map(float, place.get("quat", (1.0, 0.0, 0.0, 0.0)))
        found[name] = Place(place["body"], (x, y, z), (qw, qx, qy, qz))
    return found


def wrong_places(said: object) -> Iterator[tuple[tuple[str, ...], str]]:
    """Yield what is wrong with places: keys that lead to it, and the words behind them.

    Args:
        said: name to `body`, `position` [m] and `quat` (wxyz).
    """
    if not isinstance(said, Mapping):
        yield (), f"is {said!r:.60}; {_EXAMPLE}"
        return
    for name, place in said.items():
        if not isinstance(name, str) or not isinstance(place, Mapping):
            yield (str(name),), f"is {place!r:.60}; {_EXAMPLE}"
            continue
        for key in place:
            if key not in PLACE_KEYS:
                yield (name, str(key)), f"is not known; {alternatives(str(key), PLACE_KEYS)}"
        body = place.get("body")
        if not isinstance(body, str) or not body.strip():
            where = (name, "body") if "body" in place else (name,)
            yield where, "names no body of the model; write body: left_wrist_yaw_link"
        for key, length in (("position", 3), ("quat", 4)):
            if key in place and (wrong := wrong_numbers(key, place[key], length)):
                yield (name, key), wrong


def wrong_numbers(key: str, said: Any, length: int) -> str:
    """Return what is wrong with a position or quaternion, "" if nothing is.

    Args:
        key: `quat` must have length 1, anything else is at most 10 m from the origin.
        said: of the file.
        length: how many numbers it has.
    """
    plain = isinstance(said, (list, tuple)) and len(said) == length
    if not plain or not all(
        isinstance(x, (int, float)) and not isinstance(x, bool) and math.isfinite(x) for x in said
    ):
        return f"is {said!r:.60}; write {length} finite numbers"
    if key == "quat" and abs(math.hypot(*said) - 1.0) > 1e-3:
        return f"has length {math.hypot(*said):.4g}; write a unit quaternion, w first"
    if key != "quat" and max(map(abs, said)) > _FARTHEST:
        return f"is {said!r:.60}; write [m], at most {_FARTHEST:g}"
    return ""
