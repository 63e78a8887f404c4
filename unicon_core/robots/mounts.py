"""Where a body carries its hands: `mounts` of a robot file, or of a workflow's scene.

mounts:
  dex3_left: {body: left_wrist_yaw_link, position: [0.0415, 0.003, 0.0], quat: [1, 0, 0, 0]}
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from unicon_core.errors import alternatives

__all__ = ["MOUNT_KEYS", "Mount", "mounts_of", "wrong_mounts"]

MOUNT_KEYS = ("body", "position", "quat")

_EXAMPLE = "write {left_hand: {body: left_wrist_yaw_link, position: [x, y, z], quat: [w, x, y, z]}}"
_FARTHEST = 10.0  # [m]; no robot is larger


@dataclass(frozen=True)
class Mount:
    """Where the base of a member's model sits on the body's model."""

    body: str
    """Body of the model that carries it."""
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """In the frame of that body in [m]."""
    quat: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    """Rotation of the member's base to that body, unit quaternion wxyz."""


def mounts_of(said: Mapping[str, Mapping[str, Any]]) -> dict[str, Mount]:
    """Return the mounts that a checked mapping says, by the names that it gives them."""
    found = {}
    for name, mount in said.items():
        x, y, z = map(float, mount.get("position", (0.0, 0.0, 0.0)))
        qw, qx, qy, qz = map(float, mount.get("quat", (1.0, 0.0, 0.0, 0.0)))
        found[name] = Mount(mount["body"], (x, y, z), (qw, qx, qy, qz))
    return found


def wrong_mounts(said: object) -> Iterator[tuple[tuple[str, ...], str]]:
    """Yield what is wrong with mounts: keys that lead to it, and the words behind `mounts`.

    Args:
        said: name of a member or of its robot to `body`, `position` [m] and `quat` (wxyz).
    """
    if not isinstance(said, Mapping):
        yield (), f"is {said!r:.60}; {_EXAMPLE}"
        return
    for name, mount in said.items():
        if not isinstance(name, str) or not isinstance(mount, Mapping):
            yield (str(name),), f"is {mount!r:.60}; {_EXAMPLE}"
            continue
        for key in mount:
            if key not in MOUNT_KEYS:
                yield (name, str(key)), f"is not known; {alternatives(str(key), MOUNT_KEYS)}"
        body = mount.get("body")
        if not isinstance(body, str) or not body.strip():
            where = (name, "body") if "body" in mount else (name,)
            yield where, "names no body of the model; write body: left_wrist_yaw_link"
        for key, length in (("position", 3), ("quat", 4)):
            if key in mount and (wrong := _wrong_numbers(key, mount[key], length)):
                yield (name, key), wrong


def _wrong_numbers(key: str, said: Any, length: int) -> str:
    plain = isinstance(said, (list, tuple)) and len(said) == length
    if not plain or not all(
        isinstance(x, (int, float)) and not isinstance(x, bool) and math.isfinite(x) for x in said
    ):
        return f"is {said!r:.60}; write {length} finite numbers"
    if key == "quat" and abs(math.hypot(*said) - 1.0) > 1e-3:
        return f"has length {math.hypot(*said):.4g}; write a unit quaternion, w first"
    if key == "position" and max(map(abs, said)) > _FARTHEST:
        return f"is {said!r:.60}; write [m], at most {_FARTHEST:g}"
    return ""
