"""The model as Genesis is to read it: what it mixes otherwise than MuJoCo is said beforehand."""

from __future__ import annotations

import copy
from typing import Any, NamedTuple

import numpy as np

from unicon_core.models.loaded import import_mujoco
from unicon_core.models.touching import floors, may_touch, on_floor
from unicon_core.platforms.kit.base import Float
from unicon_core.platforms.kit.joint_model import JointModel
from unicon_core.platforms.kit.start import Start

__all__ = ["adapted", "otherwise", "resting"]


def adapted(start: Start, figures: JointModel) -> Any:
    """Return a copy of the model with the joints' figures, without limits that the kit applies.

    Args:
        start: has the model.
        figures: of the joints.
    """
    mujoco, loaded = import_mujoco(), start.loaded
    model = copy.copy(loaded.model)
    dofs = model.jnt_dofadr[loaded.joints]
    model.dof_armature[dofs] = figures.armature
    model.dof_damping[dofs] = figures.damping
    model.dof_frictionloss[dofs] = figures.friction
    # Genesis clamps a joint's force by these; the servo has the robot file's limits.
    model.actuator_ctrllimited[:] = model.actuator_forcelimited[:] = model.jnt_actfrclimited[:] = 0
    mujoco.mj_setConst(model, mujoco.MjData(model))  # inverse weights have the armature in them
    _say_friction(model, start)
    return model


def resting(start: Start) -> Float:
    """Return where all joints of the model begin, as MuJoCo's `qpos`, shape (nq,)."""
    loaded = start.loaded
    qpos = np.array(loaded.model.qpos0)
    if loaded.base is not None:
        at = int(loaded.model.jnt_qposadr[loaded.base])
        qpos[at : at + 3], qpos[at + 3 : at + 7] = start.position, start.quat
    qpos[loaded.addresses] = start.joint_pos
    return qpos


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


class _Contact(NamedTuple):
    """As MuJoCo has it between two geoms."""

    dimensions: int
    friction: Float
    """Of sliding, turning and rolling, shape (3,)."""


def _say_friction(model: Any, start: Start) -> None:
    """Give each geom the friction that MuJoCo uses between it and the floor.

    Genesis takes the larger coefficient of two geoms, whatever their priorities and pairs say.
    """
    planes = floors(model)
    wanted = {}
    for geom in on_floor(start.loaded):
        floor = next(plane for plane in planes if may_touch(model, plane, geom))
        wanted[geom] = _contact(model, floor, geom)
    for geom, contact in wanted.items():
        model.geom_condim[geom], model.geom_friction[geom] = contact
    if wanted:
        model.geom_condim[planes], model.geom_friction[planes] = 1, 0.0


def _contact(model: Any, one: int, other: int) -> _Contact:
    """https://mujoco.readthedocs.io/en/stable/modeling.html#contact-parameters"""
    for pair in range(model.npair):
        if {int(model.pair_geom1[pair]), int(model.pair_geom2[pair])} == {one, other}:
            sliding, _, turning, rolling, _ = model.pair_friction[pair]
            contact = _Contact(int(model.pair_dim[pair]), np.array((sliding, turning, rolling)))
            break
    else:
        both = [one, other]
        ranks, dims, friction = (
            array[both] for array in (model.geom_priority, model.geom_condim, model.geom_friction)
        )
        if ranks[0] != ranks[1]:
            first = int(np.argmax(ranks))
            contact = _Contact(int(dims[first]), np.array(friction[first]))
        else:
            contact = _Contact(int(dims.max()), friction.max(axis=0))
    if contact.dimensions == 1:  # no friction at all
        return contact._replace(friction=np.zeros(3))
    return contact
