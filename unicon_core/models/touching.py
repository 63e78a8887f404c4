"""Which geoms may touch: by their collision bits, or by a `<pair>` that names them."""

from __future__ import annotations

from typing import Any

import numpy as np

from unicon_core.models.loaded import LoadedModel, import_mujoco

__all__ = ["floors", "may_touch", "on_floor", "solid"]


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


def floors(model: Any) -> list[int]:
    """Return the planes of the world."""
    plane = int(import_mujoco().mjtGeom.mjGEOM_PLANE)
    geoms = range(model.ngeom)
    return [i for i in geoms if model.geom_type[i] == plane and model.geom_bodyid[i] == 0]


def on_floor(loaded: LoadedModel) -> list[int]:
    """Return the robot's geoms that may touch a floor."""
    model = loaded.model
    root = model.body_rootid[model.jnt_bodyid[loaded.joints[0]]]
    planes = floors(model)
    return [
        geom
        for geom in range(model.ngeom)
        if model.body_rootid[model.geom_bodyid[geom]] == root
        and geom not in planes
        and any(may_touch(model, floor, geom) for floor in planes)
    ]
