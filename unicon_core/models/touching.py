"""Which geoms may touch: by their collision bits, or by a `<pair>` that names them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from unicon_base.arrays import Bool, Float64
from unicon_core.models.loaded import LoadedModel, import_mujoco


class Contact(NamedTuple):
    """What MuJoCo makes of two geoms that touch."""

    dimensions: int
    friction: Float64
    """Of sliding, turning and rolling, shape (3,)."""


def solid(model: Any, geom: int) -> bool:
    """Return whether a geom may touch anything at all.

    Args:
        model: an `MjModel`.
        geom: its number.
    """
    if model.geom_contype[geom] or model.geom_conaffinity[geom]:
        return True
    return bool((model.pair_geom1 == geom).any() or (model.pair_geom2 == geom).any())


def may_touch(model: Any, one: int, other: int) -> bool:
    """Return whether two geoms may touch each other; see `solid`."""
    if (
        model.geom_contype[one] & model.geom_conaffinity[other]
        or model.geom_contype[other] & model.geom_conaffinity[one]
    ):
        return True
    firsts, seconds = model.pair_geom1, model.pair_geom2
    named = ((firsts == one) & (seconds == other)) | ((firsts == other) & (seconds == one))
    return bool(np.any(named))


def contact_of(model: Any, one: int, other: int) -> Contact:
    """Return the contact of two geoms: a `<pair>`'s, else that of the higher priority, else both's.

    https://mujoco.readthedocs.io/en/stable/modeling.html#contact-parameters
    """
    for pair in range(model.npair):
        if {model.pair_geom1[pair], model.pair_geom2[pair]} == {one, other}:
            sliding, _, turning, rolling, _ = model.pair_friction[pair]
            return Contact(int(model.pair_dim[pair]), np.array((sliding, turning, rolling)))
    both = [one, other]
    ranks, dims = model.geom_priority[both], model.geom_condim[both]
    friction = model.geom_friction[both]
    if ranks[0] != ranks[1]:
        first = int(np.argmax(ranks))
        return Contact(int(dims[first]), np.array(friction[first]))
    return Contact(int(dims.max()), friction.max(axis=0))


def still(model: Any) -> list[int]:
    """Return the geoms of the world and of the bodies that are fixed to it."""
    return np.flatnonzero(model.body_weldid[model.geom_bodyid] == 0).tolist()


def floors(model: Any) -> list[int]:
    """Return the planes that stand still."""
    plane = int(import_mujoco().mjtGeom.mjGEOM_PLANE)
    return [i for i in still(model) if model.geom_type[i] == plane]


def around(loaded: LoadedModel) -> list[int]:
    """Return what a robot may touch around it and is no floor: solid geoms that stand still."""
    model, ours, planes = loaded.model, _ours(loaded), floors(loaded.model)
    others = (geom for geom in still(model) if geom not in planes and not ours[geom])
    return [geom for geom in others if solid(model, geom)]


def on_floor(loaded: LoadedModel) -> list[int]:
    """Return the robot's geoms that may touch a floor."""
    model, planes = loaded.model, floors(loaded.model)
    own = (geom for geom in np.flatnonzero(_ours(loaded)).tolist() if geom not in planes)
    return [geom for geom in own if any(may_touch(model, floor, geom) for floor in planes)]


def _ours(loaded: LoadedModel) -> Bool:
    """Return which geoms are the robot's, shape (ngeom,)."""
    model = loaded.model
    root = model.body_rootid[model.jnt_bodyid[loaded.joints[0]]]
    ours: Bool = model.body_rootid[model.geom_bodyid] == root
    return ours
