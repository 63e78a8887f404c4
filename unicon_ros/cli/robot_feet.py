"""Feet of a robot, from its model: what lies at the end of each leg, and how it is called."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

_FOOT = re.compile(r"foot|feet|toe", re.IGNORECASE)
_CORNER = re.compile(r"^[A-Z]{2}$")
"""FL, HR and the like: of its leg's last body, the sphere that touches the ground."""


def feet_of(model: Any, legs: Sequence[Sequence[int]]) -> list[str]:
    """Return a name for the foot of each leg.

    Bodies, else sites, else geoms called feet, one for each leg; else geoms called by the corner;
    else the last bodies. A leg whose end has no name has no foot here.

    Args:
        model: an `MjModel`.
        legs: numbers of the joints of each, tip first.
    """
    owners = {
        "body": range(model.nbody),
        "site": model.site_bodyid.tolist(),
        "geom": model.geom_bodyid.tolist(),
    }
    ends = [_ends(model, int(model.jnt_bodyid[leg[0]])) for leg in legs]
    for kind, called in (("body", _FOOT), ("site", _FOOT), ("geom", _FOOT), ("geom", _CORNER)):
        names = [(getattr(model, kind)(i).name, owner) for i, owner in enumerate(owners[kind])]
        found = [
            [name for name, owner in names if owner in end and called.search(name)] for end in ends
        ]
        if all(len(each) == 1 or (each and kind == "body") for each in found):
            return [each[0] for each in found]
    return [name for end in ends if (name := model.body(min(end)).name)]


def _ends(model: Any, tip: int) -> set[int]:
    """Return a body and all below it."""
    ends = {tip}
    for body in range(tip + 1, model.nbody):  # parents come first
        if int(model.body_parentid[body]) in ends:
            ends.add(body)
    return ends
