"""Gives a walking robot a floor, and the floor the name by which `<pair>` elements call it."""

from __future__ import annotations

from typing import Any

__all__ = ["mend_floor"]

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
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    planes = [geom for geom in spec.worldbody.geoms if geom.type == plane]
    names = {geom.name for geom in spec.geoms}
    ends = [(pair, key) for pair in spec.pairs for key in ("geomname1", "geomname2")]
    lost = [(pair, key) for pair, key in ends if getattr(pair, key) not in names]
    called = list(dict.fromkeys(getattr(pair, key) for pair, key in lost))
    if not list(spec.worldbody.geoms):
        name = called[0] if called else FLOOR
        floor = spec.worldbody.add_geom(name=name, type=plane, size=[0.0, 0.0, 0.05])
        spec.worldbody.add_light(pos=[0.0, 0.0, 4.0])
        planes.append(floor)
        notes.append("the model has no surroundings: a floor was added")
    # Two names that are not there in one pair are not a robot's foot on a floor: MuJoCo tells.
    alone = [
        (pair, key)
        for pair, key in lost
        if not {pair.geomname1, pair.geomname2} <= {*called} and len(planes) == 1
    ]
    if not alone:
        return
    if not planes[0].name:
        planes[0].name = called[0]
    for pair, key in alone:
        setattr(pair, key, planes[0].name)
    said = ", ".join(called)
    notes.append(f"{len(alone)} pairs name {said}, which is not in the model: taken as its floor")
