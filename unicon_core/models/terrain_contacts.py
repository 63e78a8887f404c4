"""How ground touches a robot: as the floor of its model did, or as a patch of other friction."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from unicon_core.models.loaded import LoadedModel, import_mujoco
from unicon_core.models.posed import PosedModel

TOUCH = ("condim", "friction", "solref", "solimp", "margin", "gap")
"""What a geom and a pair say of a contact."""
_SINK = 0.001  # [m] by which the robot is put into the floor to see what a contact is like


class FloorContact(NamedTuple):
    """What MuJoCo makes of the robot's lowest part on the floor; shapes as of a geom."""

    dimensions: int
    friction: Any
    solref: Any
    solimp: Any


def floor_contact(loaded: LoadedModel, floor: int) -> FloorContact:
    """Return what the floor and the robot's lowest part make of a contact; else the floor's own."""
    mujoco, model, base = import_mujoco(), loaded.model, loaded.base
    own = FloorContact(
        int(model.geom_condim[floor]),
        np.array(model.geom_friction[floor]),
        np.array(model.geom_solref[floor]),
        np.array(model.geom_solimp[floor]),
    )
    posed = PosedModel(loaded)
    data = posed.data
    mujoco.mj_forward(model, data)
    heights = posed.heights()
    if base is None or not heights:
        return own
    data.qpos[int(model.jnt_qposadr[base]) + 2] -= min(heights.values()) + _SINK
    mujoco.mj_forward(model, data)
    for contact in data.contact:
        if floor in contact.geom:
            sliding, _, turning, rolling, _ = contact.friction
            return FloorContact(
                int(contact.dim),
                np.array((sliding, turning, rolling)),
                np.array(contact.solref),
                np.array(contact.solimp),
            )
    return own


def give_patch(geom: Any, contact: FloorContact, friction: float, rank: int) -> None:
    """Give a patch the contact that the floor had, with its own friction, before what it touches.

    MuJoCo takes the larger of two geoms' friction, or that of the higher priority
    (https://mujoco.readthedocs.io/en/stable/modeling.html#contact-parameters).
    """
    geom.priority, geom.condim = rank, contact.dimensions
    geom.friction = contact.friction * friction
    geom.solref, geom.solimp, geom.material = contact.solref, contact.solimp, ""
    shade = 0.35 + 0.5 * round(min(friction, 1.0), 1)  # the more slippery, the bluer
    geom.rgba = [shade, shade, 0.85, 1.0]


def give_pair(spec: Any, pair: Any, floor: str, name: str, friction: float) -> None:
    """Let what touches the floor by a pair touch other ground in the same way."""
    ends = {key: getattr(pair, key) for key in ("geomname1", "geomname2")}
    ends = {key: name if end == floor else end for key, end in ends.items()}
    same = {word: getattr(pair, word) for word in (*TOUCH, "solreffriction")}
    same["friction"] = np.array(pair.friction) * friction
    spec.add_pair(**ends, **same)
