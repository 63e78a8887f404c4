"""Base and IMU readings of one simulated robot, from the model's sensors or its free joint."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.platforms.kit.base import Mounting

__all__ = ["BaseReader", "find_imu"]

Float = NDArray[np.float64]
Copy = Callable[[], None]


def find_imu(mujoco: Any, model: Any, body: int) -> dict[str, int]:
    """Return the sensors of an IMU on a body by type, whatever their names.

    Args:
        body: id of the base's body.

    Returns:
        `quat`, `gyro`, `accelerometer` to the sensor's id, those that exist. Of several the
        first one of the model.
    """
    kinds = {
        int(mujoco.mjtSensor.mjSENS_FRAMEQUAT): "quat",
        int(mujoco.mjtSensor.mjSENS_GYRO): "gyro",
        int(mujoco.mjtSensor.mjSENS_ACCELEROMETER): "accelerometer",
    }
    found: dict[str, int] = {}
    for i in range(model.nsensor):
        kind = kinds.get(int(model.sensor_type[i]))
        on_site = model.sensor_objtype[i] == int(mujoco.mjtObj.mjOBJ_SITE)
        if kind is None or not on_site or model.sensor_refid[i] >= 0:
            continue
        if model.site_bodyid[model.sensor_objid[i]] == body:
            found.setdefault(kind, i)
    return found


class BaseReader:
    """Copies the base states of one robot out of its `MjData`.

    Orientation and rates are those of the base's body: the readings of an IMU that is mounted with
    a rotation are turned into the base frame. An accelerometer keeps its place (its lever arm).

    Args:
        data: the robot's `MjData`.
        joint: id of the free joint.
        views: the robot's own state arrays by name; absent ones are left out.
    """

    def __init__(
        self, mujoco: Any, model: Any, data: Any, joint: int, views: dict[str, NDArray[Any]]
    ) -> None:
        body = int(model.jnt_bodyid[joint])
        qpos = data.qpos[model.jnt_qposadr[joint] :][:7]
        qvel = data.qvel[model.jnt_dofadr[joint] :][:6]
        qacc = data.qacc[model.jnt_dofadr[joint] :][:6]
        self._rotation = data.xmat[body].reshape(3, 3)
        imu = find_imu(mujoco, model, body)
        self.source = dict.fromkeys(("quat", "gyro", "accelerometer"), "free joint")

        def sensor(kind: str) -> tuple[Float, Mounting | None] | None:
            """Return the sensor's data and how it is mounted, None as the base; None without."""
            if kind not in imu:
                return None
            self.source[kind] = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_SENSOR, imu[kind])
            start, size = int(model.sensor_adr[imu[kind]]), int(model.sensor_dim[imu[kind]])
            mounting = Mounting(model.site_quat[model.sensor_objid[imu[kind]]])
            return data.sensordata[start : start + size], mounting if mounting.turned else None

        copies: list[Copy] = []
        if "base_quat" in views:
            copies.append(_quat(views["base_quat"], sensor("quat"), qpos[3:7]))
        if "base_ang_vel" in views:
            gyro = sensor("gyro")
            copies.append(_vector(views["base_ang_vel"], gyro or (qvel[3:6], None)))
        if "base_lin_acc" in views:
            reading = sensor("accelerometer")
            if reading is not None:
                copies.append(_vector(views["base_lin_acc"], reading))
            else:
                copies.append(
                    _specific_force(views["base_lin_acc"], qacc, self._rotation, model.opt.gravity)
                )
        if "base_pos_w" in views:
            copies.append(_vector(views["base_pos_w"], (qpos[:3], None)))
        self._copies = tuple(copies)
        self._linear = qvel[:3]
        self._world = np.zeros((2, 3))
        length = float(np.linalg.norm(model.opt.gravity))
        self._world[1] = model.opt.gravity / length if length > 0.0 else (0.0, 0.0, -1.0)
        self._base = np.zeros((2, 3))
        self._lin_vel = views.get("base_lin_vel", np.zeros(3, dtype=np.float32))
        self._gravity = views.get("projected_gravity", np.zeros(3, dtype=np.float32))

    def __call__(self) -> None:
        for copy in self._copies:
            copy()
        # Rows of world vectors times the base's rotation are rows in the base frame: one product
        # turns velocity and gravity at once.
        self._world[0] = self._linear
        np.matmul(self._world, self._rotation, out=self._base)
        self._lin_vel[...] = self._base[0]
        self._gravity[...] = self._base[1]


def _quat(out: NDArray[Any], reading: tuple[Float, Mounting | None] | None, own: Float) -> Copy:
    source, mounting = (own, None) if reading is None else reading

    def plain() -> None:
        out[...] = source

    def turned() -> None:
        assert mounting is not None
        out[...] = mounting.quat(source)

    return plain if mounting is None else turned


def _vector(out: NDArray[Any], reading: tuple[Float, Mounting | None]) -> Copy:
    source, mounting = reading

    def plain() -> None:
        out[...] = source

    def turned() -> None:
        assert mounting is not None
        out[...] = mounting.vector(source)

    return plain if mounting is None else turned


def _specific_force(out: NDArray[Any], qacc: Float, rotation: Float, gravity: Float) -> Copy:
    """What an accelerometer at the base's origin reads: Rᵀ (a - g)."""
    world, base = np.zeros(3), np.zeros(3)

    def copy() -> None:
        np.subtract(qacc[:3], gravity, out=world)
        np.matmul(world, rotation, out=base)
        out[...] = base

    return copy
