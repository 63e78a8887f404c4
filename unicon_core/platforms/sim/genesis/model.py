"""The model as Genesis is to read it: what it mixes otherwise than MuJoCo is said beforehand."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np

from unicon_core.models.loaded import import_mujoco
from unicon_core.models.touching import contact_of, floors, may_touch, on_floor
from unicon_core.platforms.kit.joint_model import JointModel
from unicon_core.platforms.kit.start import Start


def adapted(start: Start, figures: JointModel) -> Any:
    """Return a copy of the model with the joints' figures, without limits that the kit applies.

    Args:
        start: has the model.
        figures: of the joints.
    """
    model = copy.copy(start.loaded.model)
    figures.tell(model, start.loaded)
    # Genesis clamps a joint's force by these; the servo limits it already.
    model.actuator_ctrllimited[:] = model.actuator_forcelimited[:] = model.jnt_actfrclimited[:] = 0
    _say_friction(model, start)
    return model


def otherwise(start: Start) -> list[str]:
    """Return what of the model Genesis reads, but does otherwise than MuJoCo, one line each."""
    mujoco, model = import_mujoco(), start.loaded.model
    opt, notes = model.opt, []
    if opt.integrator not in (mujoco.mjtIntegrator.mjINT_EULER, *_implicit(mujoco)):
        name = mujoco.mjtIntegrator(opt.integrator).name.removeprefix("mjINT_")
        notes.append(f"integrator {name} became implicitfast")
    if opt.solver == mujoco.mjtSolver.mjSOL_PGS:
        notes.append("solver PGS became Newton")
    if opt.density or opt.viscosity or np.any(opt.wind):
        notes.append("left out: air or water around the robot")
    if model.ntendon:
        notes.append(f"left out: {model.ntendon} tendons")
    if (model.geom_type == mujoco.mjtGeom.mjGEOM_HFIELD).any():
        notes.append("left out: height fields")
    if not model.eq_active0.all():
        notes.append("equality constraints that begin inactive act all the time")
    named = np.union1d(model.pair_geom1, model.pair_geom2).astype(int)
    only = named[(model.geom_contype[named] == 0) & (model.geom_conaffinity[named] == 0)]
    if len(only):
        notes.append(f"left out: contacts of {len(only)} geoms that touch by pairs alone")
    return notes


def _implicit(mujoco: Any) -> tuple[Any, Any]:
    kinds = mujoco.mjtIntegrator
    return kinds.mjINT_IMPLICIT, kinds.mjINT_IMPLICITFAST


def _say_friction(model: Any, start: Start) -> None:
    """Give each geom the friction that MuJoCo uses between it and the floor.

    Genesis takes the larger coefficient of two geoms, whatever their priorities and pairs say.
    """
    planes = floors(model)
    wanted = {}
    for geom in on_floor(start.loaded):
        floor = next(plane for plane in planes if may_touch(model, plane, geom))
        contact = contact_of(model, floor, geom)
        if contact.dimensions == 1:  # no friction at all
            contact = contact._replace(friction=np.zeros(3))
        wanted[geom] = contact
    for geom, contact in wanted.items():
        model.geom_condim[geom], model.geom_friction[geom] = contact
    if wanted:
        model.geom_condim[planes], model.geom_friction[planes] = 1, 0.0
