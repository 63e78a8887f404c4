"""The state in which a simulation begins: joint pose and height of the base."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import ModelError, PlatformError, alternatives
from unicon_core.models.loaded import LoadedModel
from unicon_core.models.posed import heights
from unicon_core.robots import Robot

__all__ = ["initial_positions"]

Pose = str | Mapping[str, float]

_CLEARANCE = 0.0005  # [m] between the lowest geom and the floor


def initial_positions(
    mujoco: Any,
    loaded: LoadedModel,
    robot: Robot,
    base: int | None,
    pose: Pose,
    keyframe: str | None,
    height: float | None,
) -> NDArray[np.float64]:
    """Return the initial `qpos` of a model, shape (nq,).

    Args:
        base: id of the robot's free joint, None for a fixed base.
        pose: `default` or `rest` of the robot file, `model` (the model's own), or a mapping of
            joint names to positions in [rad] over the default pose.
        keyframe: key frame of the model, which then says everything.
        height: of the base in [m]; None sets the lowest geom on the floor.

    Raises:
        ModelError: no such key frame.
        PlatformError: no such pose or joint.
    """
    model = loaded.model
    data = mujoco.MjData(model)
    if keyframe is not None:
        names = [model.key(i).name for i in range(model.nkey)]
        if keyframe not in names:
            raise ModelError(
                f"model {loaded.path} has no key frame {keyframe!r}; "
                f"{alternatives(keyframe, names)}; or leave keyframe out and give initial_pose"
            )
        mujoco.mj_resetDataKeyframe(model, data, names.index(keyframe))
    elif pose != "model":
        data.qpos[loaded.addresses] = _pose(robot, pose)
    if base is not None:
        z = int(model.jnt_qposadr[base]) + 2
        if height is not None:
            data.qpos[z] = height
        elif keyframe is None and pose != "model":
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            above = heights(model, data, int(model.jnt_bodyid[base]))
            data.qpos[z] += _CLEARANCE - min(above.values(), default=_CLEARANCE)
    return np.array(data.qpos)


def _pose(robot: Robot, pose: Pose) -> NDArray[np.float64]:
    standing = np.nan_to_num(robot.default_joint_pos.astype(np.float64))
    if pose == "default":
        return standing
    if pose == "rest":
        rest = robot.rest_joint_pos.astype(np.float64)
        return np.where(np.isnan(rest), standing, rest)
    if isinstance(pose, str):
        known = alternatives(pose, ("default", "rest", "model"))
        raise PlatformError(
            f"no initial_pose {pose!r}; {known}; or give a mapping of joints to [rad]"
        )
    for name, value in pose.items():
        if name not in robot.joint_names:
            raise PlatformError(
                f"initial_pose: robot {robot.name} has no joint {name!r}; "
                f"{alternatives(name, robot.joint_names)}"
            )
        standing[robot.joint_names.index(name)] = value
    return standing
