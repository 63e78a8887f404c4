"""Where a simulation begins: joint pose and height of the base, the same in every simulator."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from unicon_base.arrays import Float64
from unicon_base.errors import ModelError, alternatives
from unicon_core.models.load import load_model
from unicon_core.models.loaded import LoadedModel, import_mujoco
from unicon_core.models.posed import PosedModel
from unicon_core.platforms.kit.bodies import tell_bodies
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
    base, qpos = loaded.base, initial_positions(loaded, robot, scene)
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
    model, base = loaded.model, loaded.base
    posed = PosedModel(loaded)
    data = posed.data
    pose, height = scene.initial_pose, scene.initial_height
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
