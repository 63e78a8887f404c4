"""Gives a walking robot a floor, and the floor the name by which `<pair>` elements call it."""

from __future__ import annotations

from typing import Any

FLOOR = "floor"


def mend_floor(mujoco: Any, spec: Any, notes: list[str]) -> None:
    """Add a floor where a model has no surroundings, and let pairs that name another one name it.

    A robot's file that its author includes into scenes may name the scene's floor, whatever that is
    called; without the scene MuJoCo would refuse the pair.

    Args:
        mujoco: the module.
        spec: the `MjSpec`.
        notes: what was changed is added.
    """
    kinds = mujoco.mjtGeom
    # MuJoCo lets bodies that stand still alone have planes and height fields.
    planes = [geom for geom in spec.geoms if geom.type == kinds.mjGEOM_PLANE]
    fields = [geom for geom in spec.geoms if geom.type == kinds.mjGEOM_HFIELD]
    names = {geom.name for geom in spec.geoms}
    ends = [(pair, key) for pair in spec.pairs for key in ("geomname1", "geomname2")]
    lost = [(pair, key) for pair, key in ends if getattr(pair, key) not in names]
    called = list(dict.fromkeys(getattr(pair, key) for pair, key in lost))
    if not (list(spec.worldbody.geoms) or planes or fields):
        name = called[0] if called else FLOOR
        while name in names:
            name += "_"
        floor = spec.worldbody.add_geom(name=name, type=kinds.mjGEOM_PLANE, size=[0.0, 0.0, 0.05])
        spec.worldbody.add_light(pos=[0.0, 0.0, 4.0])
        planes.append(floor)
        notes.append("the model has no surroundings: a floor was added")
    grounds = planes or fields
    # Two names that are not there in one pair are not a robot's foot on a floor: MuJoCo tells.
    alone = [
        (pair, key)
        for pair, key in lost
        if not {pair.geomname1, pair.geomname2} <= {*called} and len(grounds) == 1
    ]
    if not alone:
        return
    if not grounds[0].name:
        grounds[0].name = called[0]
    for pair, key in alone:
        setattr(pair, key, grounds[0].name)
    said = ", ".join(called)
    notes.append(f"{len(alone)} pairs name {said}, which is not in the model: taken as its floor")
