"""What a model says of its robot's joints and contacts, for simulators that are not MuJoCo.

figures = joint_model(start, "replace")      # of the model file, `scene.joints` over it
engine.set_armature(figures.armature)
notes = lost(start, figures, represents=("damping", "friction", "contact friction"))
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np

from unicon_base.arrays import Float64
from unicon_core.models.load import actuator_kind
from unicon_core.models.loaded import (
    LoadedModel,
    around,
    contact_of,
    drives,
    floors,
    import_mujoco,
    may_touch,
    on_floor,
)
from unicon_core.platforms.kit.start import Start
from unicon_core.robots import Robot

Passive: TypeAlias = Literal["keep", "replace"]
"""`keep` the damping of a model's joints beside that of the command, or let that `replace` it."""


@dataclass(frozen=True, eq=False)
class JointModel:
    """Figures of the joints in the robot's order, each float64 of shape (n,).

    Attributes:
        passive: whether `damping` is what the model says, or 0.
        armature: inertia of the rotor, seen from the joint, in [kg·m²].
        damping: torque for each velocity that the joint itself has in [N·m·s/rad].
        friction: torque of dry friction in [N·m].
        lower: limit of position in [rad] or [m], -inf for none.
        upper: the same.
    """

    passive: Passive
    armature: Float64
    damping: Float64
    friction: Float64
    lower: Float64
    upper: Float64

    def tell(self, model: Any, loaded: LoadedModel) -> None:
        """Put armature, damping and friction into a MuJoCo model, for engines that read one.

        Args:
            model: the one of `loaded`, or a copy of it.
            loaded: says where the joints are.
        """
        mujoco = import_mujoco()
        dofs = loaded.dofs
        model.dof_armature[dofs], model.dof_damping[dofs] = self.armature, self.damping
        model.dof_frictionloss[dofs] = self.friction
        mujoco.mj_setConst(model, mujoco.MjData(model))  # the solver's inverse inertias follow


def joint_model(start: Start, passive: Passive) -> JointModel:
    """Return what the model says, and where `scene.joints` says something, that.

    Args:
        start: has the model, and what was said.
        passive: whether the model's damping acts.
    """
    model = start.loaded.model
    physics = start.physics
    joints = start.loaded.joints
    dofs = start.loaded.dofs
    armature = model.dof_armature[dofs]
    friction = model.dof_frictionloss[dofs]
    limited = model.jnt_limited[joints].astype(bool)
    lower, upper = model.jnt_range[joints].T
    return JointModel(
        passive=passive,
        armature=np.where(np.isnan(physics.armature), armature, physics.armature),
        damping=np.array(model.dof_damping[dofs]) * (passive == "keep"),
        friction=np.where(np.isnan(physics.friction), friction, physics.friction),
        lower=np.where(limited, lower, -np.inf),
        upper=np.where(limited, upper, np.inf),
    )


def ground_friction(start: Start) -> float:
    """Return the coefficient of sliding friction between the robot and its floor.

    As MuJoCo has it between each geom and the floor; of geoms that differ it is the median.
    """
    model = start.loaded.model
    found = [
        float(contact_of(model, floor, geom).friction[0])
        for geom in on_floor(start.loaded)
        for floor in floors(model)
        if may_touch(model, floor, geom)
    ]
    return float(np.median(found)) if found else 1.0


def lost(start: Start, robot: Robot, figures: JointModel, represents: Collection[str]) -> list[str]:
    """Return what the model says and an engine does not represent, one line each.

    Args:
        start: has the model.
        robot: names the joints.
        figures: of the joints.
        represents: words of what it does represent: `armature`, `damping`, `friction`, `limits`
            of joints, `self-collision`, `meshes` that collide, `contact friction` that turns and
            rolls, `targets` cut by position actuators, `constraints`, `terrain`.
    """
    mujoco = import_mujoco()
    loaded = start.loaded
    model = loaded.model
    has = {
        "armature": _joints(robot, "armature", figures.armature, "kg·m²"),
        "damping": _joints(robot, "damping", figures.damping, "N·m·s/rad"),
        "friction": _joints(robot, "dry friction", figures.friction, "N·m"),
        "limits": _limits(figures),
    }
    meshes = [g for g in on_floor(loaded) if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_MESH]
    has["meshes"] = f"{len(meshes)} geoms that collide as meshes" if meshes else ""
    has["self-collision"] = "links that touch each other" if _touch_themselves(model) else ""
    touching = on_floor(loaded)
    turning = bool(touching) and bool((model.geom_condim[touching] > 3).any())
    has["contact friction"] = "contacts with friction against turning or rolling" if turning else ""
    cut = [
        actuators[0]
        for joint, actuators in drives(model).items()
        if joint in loaded.joints
        and model.actuator_ctrllimited[actuators[0]]
        and actuator_kind(model, actuators[0]) == "position"
    ]
    has["targets"] = f"control ranges that cut the targets of {len(cut)} joints" if cut else ""
    has["constraints"] = f"{model.neq} equality constraints" if model.neq else ""
    others = around(loaded)
    has["terrain"] = f"{len(others)} geoms of the surroundings" if others else ""
    return [f"left out: {what}" for word, what in has.items() if what and word not in represents]


def _touch_themselves(model: Any) -> bool:
    """Return whether links of the robot may touch others than their own parents and children."""
    types = model.geom_contype
    affinities = model.geom_conaffinity
    bodies = model.geom_bodyid
    met = types[:, None] & affinities
    met = (met | met.T).astype(bool)
    parents = model.body_parentid[bodies]
    met[model.pair_geom1, model.pair_geom2] = True
    near = (bodies[:, None] == bodies) | (parents[:, None] == bodies)
    own = bodies > 0
    return bool((met & ~(near | near.T) & own & own[:, None]).any())


def _joints(robot: Robot, what: str, values: Float64, unit: str) -> str:
    found = np.flatnonzero(values)
    if not len(found):
        return ""
    most = int(np.argmax(values))
    return (
        f"{what} of {len(found)} joints, at most {values[most]:.3g} {unit} "
        f"({robot.joint_names[most]})"
    )


def _limits(figures: JointModel) -> str:
    count = int(np.isfinite(figures.lower).sum())
    return f"position limits of {count} joints" if count else ""
