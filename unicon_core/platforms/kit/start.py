"""Where a simulation begins: joint pose and height of the base, the same in every simulator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import ModelError, alternatives
from unicon_core.models.load import LoadedModel, import_mujoco, load_model
from unicon_core.platforms.kit.scene import KEYFRAME, Scene
from unicon_core.robots import Robot

__all__ = ["Start", "find_base", "initial_positions", "start_of"]

Float = NDArray[np.float64]

_CLEARANCE = 0.0005  # [m] between the lowest geom and the floor
_FAR = 100.0  # [m]


@dataclass(frozen=True, eq=False)
class Start:
    """Where a simulation begins.

    Attributes:
        loaded: the model.
        joint_pos: in the robot's order in [rad], shape (n,).
        position: of the base in the world in [m], shape (3,).
        quat: of the base, base to world, wxyz, shape (4,).
        floating: whether the base can move.
    """

    loaded: LoadedModel
    joint_pos: Float
    position: Float
    quat: Float
    floating: bool


def start_of(robot: Robot, scene: Scene) -> Start:
    """Return where a scene begins, in any simulator; see `initial_positions`.

    Raises:
        MissingDependencyError: mujoco, which reads the models, is not installed.
        ModelError: the model is missing or wrong, or lacks a joint.
        PlatformError: no such pose.
    """
    loaded = load_model(scene.model_path(robot), robot)
    mujoco, model = import_mujoco(), loaded.model
    base = find_base(mujoco, model, loaded.joints[0])
    qpos = initial_positions(loaded, robot, base, scene)
    joint_pos = qpos[[int(model.jnt_qposadr[joint]) for joint in loaded.joints]]
    if base is not None:
        pose = qpos[int(model.jnt_qposadr[base]) :][:7]
        return Start(loaded, joint_pos, pose[:3], pose[3:], True)
    return Start(loaded, joint_pos, np.zeros(3), np.array((1.0, 0.0, 0.0, 0.0)), False)


def find_base(mujoco: Any, model: Any, joint: int) -> int | None:
    """Return the id of the free joint that carries a robot's joint, or None for a fixed base."""
    body = int(model.jnt_bodyid[joint])
    while body != 0:
        first = int(model.body_jntadr[body])
        if first >= 0 and model.jnt_type[first] == int(mujoco.mjtJoint.mjJNT_FREE):
            return first
        body = int(model.body_parentid[body])
    return None


def initial_positions(loaded: LoadedModel, robot: Robot, base: int | None, scene: Scene) -> Float:
    """Return the initial `qpos` of a model, shape (nq,).

    Args:
        loaded: the model.
        robot: the robot.
        base: id of the robot's free joint, None for a fixed base.
        scene: says pose and height; a key frame and the model's own pose say the height too.

    Raises:
        ModelError: no such key frame.
        PlatformError: no such pose.
    """
    mujoco = import_mujoco()
    model = loaded.model
    data = mujoco.MjData(model)
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
        data.qpos[[int(model.jnt_qposadr[j]) for j in loaded.joints]] = scene.joint_pos(robot)
    if base is not None:
        z = int(model.jnt_qposadr[base]) + 2
        if height is not None:
            data.qpos[z] = height
        elif not scene.posed_by_model:
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            data.qpos[z] += _lift(mujoco, model, data, int(model.jnt_bodyid[base]))
    return np.array(data.qpos)


def _lift(mujoco: Any, model: Any, data: Any, body: int) -> float:
    """Return how far to raise the base so that the robot stands on the floor in [m], else 0."""
    floors = [
        i
        for i in range(model.ngeom)
        if model.geom_type[i] == int(mujoco.mjtGeom.mjGEOM_PLANE) and model.geom_bodyid[i] == 0
    ]
    own = _geoms_of(model, body)
    distances = [
        mujoco.mj_geomDistance(model, data, floor, geom, _FAR, None)
        for floor in floors
        for geom in own
        if model.geom_contype[floor] & model.geom_conaffinity[geom]
        or model.geom_contype[geom] & model.geom_conaffinity[floor]
    ]
    return _CLEARANCE - min(distances) if distances else 0.0


def _geoms_of(model: Any, root: int) -> Sequence[int]:
    return [i for i in range(model.ngeom) if model.body_rootid[model.geom_bodyid[i]] == root]
