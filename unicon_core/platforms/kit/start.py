"""Where a simulation begins, in every simulator: pose and height, payload, friction and gantry."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from unicon_base import AnyMapping, ModelError, PlatformError, alternatives
from unicon_base.arrays import Float64
from unicon_core.models.load import load_model
from unicon_core.models.loaded import LoadedModel, import_mujoco
from unicon_core.models.posed import PosedModel
from unicon_core.platforms.kit.scene import KEYFRAME, Scene
from unicon_core.robots import Robot
from unicon_core.robots.load import JointPhysics, joint_physics

_CLEARANCE = 0.0005  # [m] between the lowest geom and the floor


@dataclass(frozen=True, eq=False)
class Start:
    """Where a simulation begins.

    Attributes:
        loaded: the model.
        joint_pos: in the robot's order in [rad], shape (n,).
        position: of the base in the world in [m], shape (3,).
        quat: of the base, base to world, wxyz, shape (4,).
        floating: whether the base can move.
        physics: what the simulator is told of the joints.
    """

    loaded: LoadedModel
    joint_pos: Float64
    position: Float64
    quat: Float64
    floating: bool
    physics: JointPhysics

    @property
    def qpos(self) -> Float64:
        """The same as MuJoCo's `qpos`, shape (nq,); joints that are not the robot's as modelled."""
        loaded = self.loaded
        qpos = np.array(loaded.model.qpos0)
        if loaded.base is not None:
            qpos[int(loaded.model.jnt_qposadr[loaded.base]) :][:7] = *self.position, *self.quat
        qpos[loaded.addresses] = self.joint_pos
        return qpos

    @property
    def gravity(self) -> Float64:
        """Of the model, in the world in [m/s²], shape (3,)."""
        return np.array(self.loaded.model.opt.gravity)


def start_of(robot: Robot, scene: Scene) -> Start:
    """Return where a scene begins, in any simulator; see `initial_positions`.

    Raises:
        MissingDependencyError: mujoco, which reads the models, is not installed.
        ModelError: the model is missing or wrong, or lacks a joint.
        PlatformError: no such pose, or no such body.
    """
    # No stand-ins for absent joints: other engines know neither armature nor implicit damping.
    # Nothing attached either: they read the file themselves.
    alone = replace(robot, weldable=frozenset(), mounts={})
    try:
        loaded = load_model(scene.model_path(robot), alone)
    except ModelError as error:
        if not robot.mounts or not robot.members:
            raise
        raise ModelError(
            f"robot {robot.name} is made of members, and this simulator reads one file "
            f"({scene.model_path(robot)}) and cannot attach the others: choose platform: mujoco, "
            "name a model of the whole (scene: {model: PATH}), or give each member a platform: "
            f"{{{', '.join(f'{member}: …' for member in robot.members)}}}"
        ) from error
    tell_bodies(loaded, scene.payload, scene.contact_friction)
    base = loaded.base
    qpos = initial_positions(loaded, robot, scene)
    pose = np.array((0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0))
    if base is not None:
        pose = qpos[int(loaded.model.jnt_qposadr[base]) :][:7]
    physics = joint_physics(robot, scene.joints)
    return Start(loaded, qpos[loaded.addresses], pose[:3], pose[3:], base is not None, physics)


def initial_positions(loaded: LoadedModel, robot: Robot, scene: Scene) -> Float64:
    """Return the initial `qpos` of a model, shape (nq,).

    Args:
        loaded: the model.
        robot: the robot.
        scene: says pose and height; a key frame and the model's own pose say the height too.

    Raises:
        ModelError: no such key frame.
        PlatformError: no such pose.
    """
    mujoco = import_mujoco()
    model = loaded.model
    base = loaded.base
    posed = PosedModel(loaded)
    data = posed.data
    pose = scene.initial_pose
    height = scene.initial_height
    if isinstance(pose, str) and pose.startswith(KEYFRAME):
        keyframe = pose.removeprefix(KEYFRAME)
        names = [model.key(i).name for i in range(model.nkey)]
        if keyframe not in names:
            raise ModelError(
                f"model {loaded.path} has no key frame {keyframe!r}; "
                f"{alternatives(keyframe, names)}; correct scene.initial_pose"
            )
        mujoco.mj_resetDataKeyframe(model, data, names.index(keyframe))
    elif not scene.posed_by_model:
        posed.put(scene.joint_pos(robot))
    if base is not None:
        z = int(model.jnt_qposadr[base]) + 2
        if height is not None:
            data.qpos[z] = height
        elif not scene.posed_by_model:
            data.qpos[z] += _CLEARANCE - min(posed.heights().values(), default=_CLEARANCE)
    return np.array(data.qpos)


def tell_bodies(loaded: LoadedModel, payload: AnyMapping, friction: float) -> None:
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


def tell_joints(loaded: LoadedModel, physics: JointPhysics) -> None:
    """Put friction [N·m] and armature [kg·m²] of joints in place of the model's own."""
    model = loaded.model
    told = {"dof_frictionloss": physics.friction, "dof_armature": physics.armature}
    if all(np.isnan(values).all() for values in told.values()):
        return
    dofs = loaded.dofs
    for name, values in told.items():
        array = getattr(model, name)
        array[dofs] = np.where(np.isnan(values), array[dofs], values)
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
    before = float(model.body_mass[body])
    centre = np.array(model.body_ipos[body])
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
    return way @ way * np.eye(3) - np.outer(way, way)


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
    w = 2.0 * math.pi * FREQUENCY
    mass = float(model.body_subtreemass[model.jnt_bodyid[base]])
    pose = int(model.jnt_qposadr[base])
    twist = int(model.jnt_dofadr[base])
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
