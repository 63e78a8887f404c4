"""Links as a physics engine wants them: each with a mass, and no frames without a body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from unicon_core.models.kinematic_tree import read_tree
from unicon_core.models.links import Link
from unicon_core.models.loaded import LoadedModel
from unicon_core.models.urdf_write import urdf
from unicon_core.robots import Robot

_LIGHT, _SMALL = 1e-4, 1e-6  # [kg], [kg·m²] of a link between two joints of one body


def physical_urdf(loaded: LoadedModel, robot: Robot) -> str:
    """Return a model as URDF text for a physics engine that reads no MJCF."""
    return urdf(physical_links(read_tree(loaded.model, robot, colliding=True)), robot)


def physical_links(links: Sequence[Link]) -> list[Link]:
    """Return the same tree for an engine that takes a link without inertia for one of 1 kg.

    A link that coincides with its parent becomes a part of it; a frame without mass and geoms goes.

    Args:
        links: root first, as `kinematic_tree.read_tree` gives them.
    """
    kept: list[Link] = []
    place: dict[int, int] = {}  # of a link -> of what it became
    parents = {link.parent for link in links}
    for i, link in enumerate(links):
        parent = place.get(link.parent, -1)
        still = not link.joint and parent >= 0
        if still and not link.position.any() and abs(link.quat[0]) > 1.0 - 1e-9:
            into = kept[parent]
            if link.mass > 0.0 and into.mass == 0.0:
                into = replace(
                    into,
                    mass=link.mass,
                    centre=link.centre,
                    inertia=link.inertia,
                    inertia_quat=link.inertia_quat,
                )
            if into.mass == link.mass or link.mass == 0.0:
                kept[parent] = replace(into, geoms=[*into.geoms, *link.geoms])
                place[i] = parent
                continue
        if still and i not in parents and link.mass == 0.0 and not link.geoms:
            continue
        place[i] = len(kept)
        kept.append(replace(link, parent=parent))
    return [
        link if link.mass > 0.0 else replace(link, mass=_LIGHT, inertia=np.full(3, _SMALL))
        for link in kept
    ]
