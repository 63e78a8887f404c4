"""A camera of a robot's model: what it sees of a pose, its intrinsics and its optical frame.

MuJoCo draws, whatever simulates the robot. Its documentation (Modeling, "Cameras"; XML reference,
`camera`): a camera looks along the -z axis of its frame, with x right and y up; `fovy` is the
vertical field of view, unless `sensorsize` gives intrinsics. An optical frame has z forward, x
right and y down (REP-103): half a turn about x.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base import ModelError, UniconError, alternatives, one_line
from unicon_base.arrays import Array, Float64
from unicon_core.models.kinematic_tree import frame_of
from unicon_core.models.loaded import body_in, import_mujoco, multiply
from unicon_core.models.posed import PosedModel
from unicon_core.models.terrain import load_on
from unicon_core.robots import Robot
from unicon_core.terrain.words import Terrain

NO_GL = (
    "{what}: no offscreen OpenGL ({reason}); on Debian and Ubuntu: apt install libegl1 "
    "libgl1-mesa-dri, or libosmesa6 with MUJOCO_GL=osmesa"
)
ODOM = "odom"
"""The frame of the world that the states' base poses are in (REP-105)."""
OPTICAL = np.array((0.0, 1.0, 0.0, 0.0))
"""Optical frame to MuJoCo's camera frame, wxyz."""


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole without distortion, in [pixels]; the middle of the first pixel is (0, 0).

    Attributes:
        fx, fy: focal lengths; 0 where the camera is not a pinhole.
        cx, cy: principal point.
    """

    fx: float
    fy: float
    cx: float
    cy: float


class ModelCamera:
    """Draws what a camera of a robot's model sees.

    Args:
        path: MJCF or URDF of the robot.
        robot: whose joints the model has.
        name: of the camera.
        size: width and height of the picture, [pixels].
        terrain: ground under the robot, None for flat.
        body: body to mount the camera on; None for one that the model has.
        position: where it is mounted in the body's frame, [m]; it looks along x, z is up.
        fovy: vertical field of view of a mounted camera, [deg].
        depth: draw depths and not colours.

    Attributes:
        pinhole: what the pictures are taken with.
        mount: parent frame of the optical frame, position [m] and quaternion wxyz, or None.

    Raises:
        UniconError: no such camera or body, or there is no offscreen OpenGL.
    """

    def __init__(
        self,
        path: Path,
        robot: Robot,
        name: str,
        size: tuple[int, int],
        *,
        terrain: Terrain | None = None,
        body: str | None = None,
        position: Sequence[float] = (0.0, 0.0, 0.0),
        fovy: float = 60.0,
        depth: bool = False,
    ) -> None:
        mujoco = drawing_mujoco("camera")

        def prepare(spec: Any) -> None:
            vis = spec.visual.global_
            vis.offwidth = max(size[0], vis.offwidth)
            vis.offheight = max(size[1], vis.offheight)
            if body is not None:
                # MuJoCo's cameras look along -z with y up; this one along the body's x, z up.
                body_in(spec, body, "camera", path).add_camera(
                    name=name, pos=position, quat=[0.5, 0.5, -0.5, -0.5], fovy=fovy
                )
            elif name not in (known := [each.name for each in spec.cameras]):
                raise ModelError(
                    f"camera: no camera {name!r} in {path}; {alternatives(name, known)}; "
                    "or mount one: body: NAME, position: [m]"
                )

        self._posed = PosedModel(load_on(path, robot, terrain, prepare=prepare))
        self._mujoco = mujoco
        model = self._posed.loaded.model
        self._camera = int(model.camera(name).id)
        self._renderer = offscreen(model, size, "camera")
        if depth:
            self._renderer.enable_depth_rendering()
        self.pinhole = intrinsics(model, self._camera, *size)
        self.mount = optical_frame(model, robot, self._camera)

    def shoot(self, joint_pos: Float64, base: Float64) -> Array:
        """Return the picture of a pose, as `PosedModel.put` takes it.

        Returns:
            RGB as uint8, shape (height, width, 3); or depths along the view axis in [m] as float32,
            shape (height, width). The caller may change it.
        """
        data = self._posed.put(joint_pos, base)
        self._mujoco.mj_camlight(self._posed.loaded.model, data)
        self._renderer.update_scene(data, self._camera)
        picture: Array = self._renderer.render()
        return picture


def drawing_mujoco(what: str) -> Any:
    """Return the mujoco module; as `offscreen`, since a wrong MUJOCO_GL fails at its import."""
    try:
        return import_mujoco()
    except Exception as error:
        raise _no_gl(error, what) from error


def offscreen(model: Any, size: tuple[int, int], what: str) -> Any:
    """Return a `mujoco.Renderer`; without a display by EGL, unless MUJOCO_GL names another.

    Args:
        model: an `MjModel`.
        size: width and height of a picture, [pixels].
        what: begins the message.

    Raises:
        UniconError: there is no offscreen OpenGL.
    """
    if not os.environ.get("MUJOCO_GL") and not os.environ.get("DISPLAY"):
        os.environ["MUJOCO_GL"] = "egl"
    try:
        return import_mujoco().Renderer(model, size[1], size[0])
    except Exception as error:  # GL libraries raise classes of their own
        raise _no_gl(error, what) from error


def _no_gl(error: Exception, what: str) -> UniconError:
    if isinstance(error, UniconError):
        return error
    return UniconError(NO_GL.format(what=what, reason=one_line(error)))


def intrinsics(model: Any, camera: int, width: int, height: int) -> Intrinsics:
    """Return what a picture of a camera is taken with; all 0 for one without perspective.

    Args:
        model: an `MjModel`.
        camera: its number there.
        width: of the picture, [pixels].
        height: of the picture, [pixels].
    """
    if model.cam_projection[camera]:  # 0 is perspective
        return Intrinsics(0.0, 0.0, 0.0, 0.0)
    middle = 0.5 * (width - 1), 0.5 * (height - 1)
    across, down = map(float, model.cam_sensorsize[camera])
    if not down > 0.0:  # square pixels
        focal = 0.5 * height / float(np.tan(0.5 * np.radians(model.cam_fovy[camera])))
        return Intrinsics(focal, focal, *middle)
    fx, fy, right, up = map(float, model.cam_intrinsic[camera])  # [m]
    right = right / across * width
    up = up / down * height
    return Intrinsics(fx / across * width, fy / down * height, middle[0] - right, middle[1] - up)


def optical_frame(model: Any, robot: Robot, camera: int) -> tuple[str, Float64, Float64] | None:
    """Return the parent frame of a camera's optical frame, its position [m] and quaternion wxyz.

    The parent is the frame of the robot's link that carries the camera, as /tf has it. A camera
    that stands in the world has its place in `odom`, or in the base of a robot that stands there.

    Args:
        model: an `MjModel` that has the robot's joints.
        robot: gives names to the frames.
        camera: its number in the model.

    Returns:
        None for a camera that turns by itself, such as one that tracks a body.
    """
    mujoco = import_mujoco()
    if model.cam_mode[camera] != int(mujoco.mjtCamLight.mjCAMLIGHT_FIXED):
        return None
    carrier = frame_of(model, robot, int(model.cam_bodyid[camera]))
    if carrier is not None:
        name, origin = carrier
        return name, model.cam_pos[camera] - origin, multiply(model.cam_quat[camera], OPTICAL)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_camlight(model, data)
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, data.cam_xmat[camera])
    world = frame_of(model, robot, 0)
    return world[0] if world else ODOM, data.cam_xpos[camera].copy(), multiply(quat, OPTICAL)
