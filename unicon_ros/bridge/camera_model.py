"""A MuJoCo camera as ROS sees it: intrinsics for CameraInfo, and where its optical frame is.

MuJoCo's documentation (Modeling, "Cameras"; XML reference, `camera`): a camera looks along the -z
axis of its frame, with x right and y up; `fovy` is the vertical field of view, unless `sensorsize`
gives intrinsics. An optical frame has z forward, x right and y down (REP-103): half a turn about x.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from unicon_core.models.kinematic_tree import frame_of
from unicon_core.models.quaternions import Float, multiply
from unicon_core.robots import Robot
from unicon_ros.bridge.images import Intrinsics

__all__ = ["intrinsics", "optical_frame"]

ODOM = "odom"
"""The frame of the world that the states' base poses are in (REP-105)."""
OPTICAL = np.array((0.0, 1.0, 0.0, 0.0))
"""Optical frame to MuJoCo's camera frame, wxyz."""


def intrinsics(model: Any, camera: int, width: int, height: int) -> Intrinsics:
    """Return what a picture of a camera is taken with; all 0 for one without perspective.

    Args:
        model: an `MjModel`.
        camera: its number there.
        width: of the picture, [pixels].
        height: of the picture, [pixels].
    """
    # Older MuJoCos have cam_orthographic in its place; 0 is perspective in both.
    field = "cam_projection" if hasattr(model, "cam_projection") else "cam_orthographic"
    if getattr(model, field)[camera]:
        return Intrinsics(0.0, 0.0, 0.0, 0.0)
    whole = Intrinsics.of_fovy(width, height, float(np.radians(model.cam_fovy[camera])))
    across, down = (float(size) for size in model.cam_sensorsize[camera])
    if not down > 0.0:
        return whole
    fx, fy, right, up = (float(value) for value in model.cam_intrinsic[camera])  # [m]
    right, up = right / across * width, up / down * height
    return Intrinsics(fx / across * width, fy / down * height, whole.cx - right, whole.cy - up)


def optical_frame(
    mujoco: Any, model: Any, robot: Robot, camera: int
) -> tuple[str, Float, Float] | None:
    """Return the parent frame of a camera's optical frame, its position [m] and quaternion wxyz.

    The parent is the frame of the robot's link that carries the camera, as /tf has it. A camera
    that stands in the world has its place in `odom`, or in the base of a robot that stands there.

    Args:
        mujoco: the module.
        model: an `MjModel` that has the robot's joints.
        robot: gives names to the frames.
        camera: its number in the model.

    Returns:
        None for a camera that turns by itself, such as one that tracks a body.
    """
    if model.cam_mode[camera] != int(mujoco.mjtCamLight.mjCAMLIGHT_FIXED):
        return None
    carrier = frame_of(model, robot, int(model.cam_bodyid[camera]))
    if carrier is not None:
        name, origin = carrier
        position, quat = model.cam_pos[camera] - origin, np.array(model.cam_quat[camera])
        return name, position, multiply(quat, OPTICAL)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_camlight(model, data)
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, data.cam_xmat[camera])
    world = frame_of(model, robot, 0)
    return world[0] if world else ODOM, data.cam_xpos[camera].copy(), multiply(quat, OPTICAL)
