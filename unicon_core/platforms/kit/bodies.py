"""What a scene says of bodies: a payload, the friction of contacts, a gantry; for simulators.

scene: {payload: {mass: 3.0, body: trunk, position: [0.0, 0.0, 0.08]}, contact_friction: 0.5}
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from unicon_base.arrays import Float64
from unicon_base.errors import PlatformError, alternatives
from unicon_base.schema.marks import Point, Within
from unicon_core.models.loaded import LoadedModel, import_mujoco

BODY_PHYSICS = ("payload", "contact_friction")
"""Words of `Facts.physics` that are about bodies."""

HEAVIEST = 1000.0
"""Of a payload in [kg]."""
ROUGHEST = 20.0
"""Factor on friction: rubber on rubber has some 1.2, ice on steel 0.03 (about a fortieth)."""


@dataclass(frozen=True)
class Payload:
    """A point with mass that is fixed to a body.

    Attributes:
        mass: of the point.
        body: of the model; the base's unless given.
        position: in that body's frame; its centre of mass unless given.
    """

    mass: Annotated[float, Within(0.0, HEAVIEST, "kg")]
    body: str = ""
    position: Point = (0.0, 0.0, 0.0)


def tell_bodies(loaded: LoadedModel, payload: Mapping[str, Any], friction: float) -> None:
    """Put a payload and the factor on all friction into a model.

    Args:
        loaded: the model, which is changed.
        payload: as of `Scene.payload`, with nothing wrong in it.
        friction: factor on sliding, turning and rolling friction of geoms and pairs. A contact has
            the larger one of two geoms' friction, so that all contacts change by this factor.

    Raises:
        PlatformError: the model has no such body, or no base to carry it.
    """
    model = loaded.model
    if friction != 1.0:
        model.geom_friction *= friction
        model.pair_friction *= friction
    if payload and payload["mass"]:
        body = _carrier(loaded, str(payload.get("body", "")))
        _add(model, body, float(payload["mass"]), payload.get("position"))
        mujoco = import_mujoco()
        mujoco.mj_setConst(model, mujoco.MjData(model))  # the solver's inverse inertias follow


def _carrier(loaded: LoadedModel, name: str) -> int:
    """Return the id of the body that carries the payload."""
    model = loaded.model
    if name:
        names = [model.body(i).name for i in range(model.nbody)]
        if name in names[1:]:
            return names.index(name, 1)
        raise PlatformError(
            f"scene.payload: model {loaded.path} has no body {name!r}; "
            f"{alternatives(name, filter(None, names[1:]))}"
        )
    if loaded.base is None:
        raise PlatformError("scene.payload: the robot has no base that moves; name a body")
    return int(model.jnt_bodyid[loaded.base])


def _add(model: Any, body: int, mass: float, position: Any) -> None:
    """Add a point to a body's mass, centre and inertia: Steiner's theorem about the new centre.

    I = R I₀ Rᵀ + m₀ (|d|² E - d dᵀ) + m (|e|² E - e eᵀ), where d and e are the ways from the new
    centre to the old one and to the point.
    """
    mujoco = import_mujoco()
    before, centre = float(model.body_mass[body]), np.array(model.body_ipos[body])
    point = centre if position is None else np.array(position, np.float64)
    total = before + mass
    model.body_mass[body] = total
    if position is None:
        return  # where it is, it turns nothing
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[body])
    axes = turn.reshape(3, 3)
    middle = (before * centre + mass * point) / total
    inertia = axes @ np.diag(model.body_inertia[body]) @ axes.T
    inertia += before * _steiner(centre - middle) + mass * _steiner(point - middle)
    values, vectors = np.linalg.eigh(inertia)
    vectors[:, 0] *= np.sign(np.linalg.det(vectors))  # a rotation, no mirror
    model.body_ipos[body], model.body_inertia[body] = middle, values
    mujoco.mju_mat2Quat(model.body_iquat[body], np.ascontiguousarray(vectors).reshape(-1))
    # What the compiler found to coincide with the old inertial frame does so no more.
    model.body_sameframe[body] = model.body_simple[body] = 0
    model.geom_sameframe[model.geom_bodyid == body] = 0
    model.site_sameframe[model.site_bodyid == body] = 0


def _steiner(way: Float64) -> Float64:
    return np.asarray(way @ way * np.eye(3) - np.outer(way, way))


GANTRY = "gantry"
"""Word of `Facts.physics`: a base that is held."""

FREQUENCY = 2.0
"""Of the critically damped springs in [Hz]: slow against a physics step, quick against a leg."""
RADIUS = 0.3
"""Of gyration that the turning dampers are made for, in [m]."""


def hold(model: Any, base: int, qpos: Float64) -> None:
    """Let the model's own springs hold a base where it begins.

        f = k (p* - p) - 2 m w v,   t = k (q* - q) - 2 sqrt(k m) r omega,   k = m w²

    with the mass m [kg] of all that hangs, and p* higher by g / w², so that the springs bear it.
    MuJoCo's free joint has one stiffness, in [N/m] and in [N·m/rad]. A light base on limp legs
    needs dampers that are integrated implicitly, so Euler does that from here on, even where the
    model forbids it (`eulerdamp`).

    Args:
        model: the `MjModel`, which is changed.
        base: number of its free joint.
        qpos: where the robot begins, shape (nq,).
    """
    model.opt.disableflags &= ~int(import_mujoco().mjtDisableBit.mjDSBL_EULERDAMP)
    w, mass = 2.0 * math.pi * FREQUENCY, float(model.body_subtreemass[model.jnt_bodyid[base]])
    pose, twist = int(model.jnt_qposadr[base]), int(model.jnt_dofadr[base])
    model.jnt_stiffness[base] = mass * w * w
    model.qpos_spring[pose : pose + 7] = qpos[pose : pose + 7]
    model.qpos_spring[pose : pose + 3] -= model.opt.gravity / (w * w)
    model.dof_damping[twist : twist + 3] = 2.0 * mass * w
    model.dof_damping[twist + 3 : twist + 6] = 2.0 * mass * w * RADIUS


def let_go(model: Any, base: int) -> None:
    """Hold it no longer."""
    twist = int(model.jnt_dofadr[base])
    model.jnt_stiffness[base] = 0.0
    model.dof_damping[twist : twist + 6] = 0.0
