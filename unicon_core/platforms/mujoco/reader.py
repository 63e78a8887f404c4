"""What one simulated robot measures, out of its `MjData`, and a rehearsal that warms caches up.

Base and IMU come from the model's sensors, or from its free joint.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from unicon_base.arrays import Array, Float64
from unicon_core.models.loaded import LoadedModel, import_mujoco, index_of

Copy = Callable[[], None]


def find_imu(model: Any, body: int) -> dict[str, int]:
    """Return the sensors of an IMU on a body by type, whatever their names.

    Args:
        body: id of the base's body.

    Returns:
        `quat`, `gyro`, `accelerometer` to the sensor's id, those that exist. Of several the
        first one of the model.
    """
    mujoco = import_mujoco()
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


def without_sensors(model: Any) -> int:
    """Return the flag under which steps leave sensors alone; 0 where each step adds to them."""
    late = getattr(model, "nhistory", 0) or np.any(getattr(model, "sensor_interval", 0))
    return 0 if late or model.nplugin else int(import_mujoco().mjtDisableBit.mjDSBL_SENSOR)


class BaseReader:
    """Copies the base states of one robot out of its `MjData`.

    Orientation and rates are those of the base's body: the readings of an IMU that is mounted with
    a rotation are turned into the base frame. An accelerometer keeps its place (its lever arm).

    Args:
        loaded: the model of a robot whose base floats; one without an accelerometer has it where
            the robot's IMU is.
        data: the robot's `MjData`.
        views: the robot's own state arrays by name; absent ones are left out.
    """

    def __init__(self, loaded: LoadedModel, data: Any, views: Mapping[str, Array]) -> None:
        model = loaded.model
        joint = loaded.base
        body = int(model.jnt_bodyid[joint])
        qpos = data.qpos[model.jnt_qposadr[joint] :][:7]
        qvel = data.qvel[model.jnt_dofadr[joint] :][:6]
        qacc = data.qacc[model.jnt_dofadr[joint] :][:6]
        self._rotation = data.xmat[body].reshape(3, 3)
        imu = find_imu(model, body)
        kinds = "quat", "gyro", "accelerometer"
        self.source: dict[str, str | None] = dict.fromkeys(kinds, "free joint")

        def sensor(kind: str) -> tuple[Float64, Float64]:
            """Return the sensor's data and the orientation of its site in the base."""
            self.source[kind] = model.sensor(imu[kind]).name or None
            start = int(model.sensor_adr[imu[kind]])
            size = int(model.sensor_dim[imu[kind]])
            quat = np.array(model.site_quat[model.sensor_objid[imu[kind]]], np.float64)
            return data.sensordata[start : start + size], quat

        copies: list[Copy] = []
        for name, kind, own in (
            ("base_quat", "quat", qpos[3:7]),
            ("base_ang_vel", "gyro", qvel[3:6]),
            ("base_lin_acc", "accelerometer", None),
            ("base_pos_w", "", qpos[:3]),
        ):
            if name not in views:
                continue
            out = views[name]
            if kind in imu:
                copies.append(_turned(out, *sensor(kind)))
            elif own is not None:
                copies.append(_plain(out, own))
            else:
                how = self._rotation, model.opt.gravity, loaded.imu_position
                copies.append(_specific_force(out, qvel, qacc, *how))
        self._copies = tuple(copies)
        self._linear = qvel[:3]
        self._world = np.zeros((2, 3))
        length = float(np.linalg.norm(model.opt.gravity))
        self._world[1] = model.opt.gravity / length if length > 0.0 else (0.0, 0.0, -1.0)
        self._base = np.zeros((2, 3))
        self._lin_vel = views.get("base_lin_vel", np.zeros(3, np.float32))
        self._gravity = views.get("projected_gravity", np.zeros(3, np.float32))

    def __call__(self) -> None:
        for copy in self._copies:
            copy()
        # Rows of world vectors times the base's rotation are rows in the base frame: one product
        # turns velocity and gravity at once.
        self._world[0] = self._linear
        np.matmul(self._world, self._rotation, out=self._base)
        self._lin_vel[...] = self._base[0]
        self._gravity[...] = self._base[1]


def _plain(out: Array, source: Float64) -> Copy:
    def plain() -> None:
        out[...] = source

    return plain


def _turned(out: Array, source: Float64, base_from_site: Float64) -> Copy:
    """What brings a vector or, of four numbers, an orientation of the site into the base frame."""
    if np.allclose(np.abs(base_from_site), (1.0, 0.0, 0.0, 0.0), atol=1e-9):
        return _plain(out, source)
    mujoco = import_mujoco()
    turn = mujoco.mju_rotVecQuat
    by = base_from_site
    result = np.zeros(len(source))
    if len(source) == 4:
        turn = mujoco.mju_mulQuat
        by = base_from_site * (1.0, -1.0, -1.0, -1.0)

    def turned() -> None:
        turn(result, source, by)
        out[...] = result

    return turned


def _specific_force(
    out: Array, qvel: Float64, qacc: Float64, rotation: Float64, gravity: Float64, arm: Float64
) -> Copy:
    """What an accelerometer reads at p: Rᵀ (a - g) + α x p + ω x (ω x p), in the base's frame.

    A free joint's rates and their derivatives are along the body's own axes.
    """
    world = np.zeros(3)
    base = np.zeros(3)
    if not arm.any():

        def at_origin() -> None:
            np.subtract(qacc[:3], gravity, out=world)
            np.matmul(world, rotation, out=base)
            out[...] = base

        return at_origin
    x, y, z = arm
    across = np.array(((0.0, z, -y), (-z, 0.0, x), (y, -x, 0.0)))  # @ α = α x p

    def at_arm() -> None:
        np.subtract(qacc[:3], gravity, out=world)
        np.matmul(world, rotation, out=base)
        rate = qvel[3:6]
        # ω x (ω x p) = ω (ω · p) - p (ω · ω)
        out[...] = base + across @ qacc[3:6] + rate * rate.dot(arm) - arm * rate.dot(rate)

    return at_arm


class Reader:
    """Copies joints and base of one robot into arrays.

    Args:
        loaded: the model.
        data: the robot's `MjData`.
        views: arrays by state, without a batch axis; what is not among them is left out.

    Attributes:
        sources: what the base states are read from, as of `BaseReader`; {} for a fixed base.
    """

    def __init__(self, loaded: LoadedModel, data: Any, views: Mapping[str, Array]) -> None:
        q_index = index_of(loaded.addresses.tolist())
        v_index = index_of(loaded.dofs.tolist())
        sources = ((data.qpos, q_index), (data.qvel, v_index), (data.qfrc_actuator, v_index))
        self._copies = [
            (views[name], source[index] if isinstance(index, slice) else None, source, index)
            for name, (source, index) in zip(("joint_pos", "joint_vel", "joint_effort"), sources)
            if name in views
        ]
        self._base = None if loaded.base is None else BaseReader(loaded, data, views)
        self.sources = {} if self._base is None else dict(self._base.source)

    def __call__(self) -> None:
        for out, view, source, index in self._copies:
            out[...] = source[index] if view is None else view
        if self._base is not None:
            self._base()


LONGEST_NS = 400_000
"""Of a rehearsal: before a deadline there is a millisecond for all of them, and where a step takes
that long it is hardly slower for cold caches."""

RUNNING = 4
"""So many longer ones running, and rehearsals rest: the first before a deadline is itself cold."""

REST = 256
"""Rehearsals that are then left out; each time twice as many."""


class Rehearsal:
    """Simulates one physics step in place, under the last command, and sets everything back.

    `mj_copyData` brings back all there is: contacts, forces, warm start, sensors, counters. A
    step blows up where the real one would; what MuJoCo says of that is not said.

    Args:
        mujoco: the module.
        model: the `MjModel`.
        data: the robot's `MjData`.
        read: what `recv` does, but into arrays that nobody sees.
        split: the step is `mj_step2` and `mj_step1`, else `mj_step`.
    """

    def __init__(self, mujoco: Any, model: Any, data: Any, read: Reader, split: bool) -> None:
        self._mujoco = mujoco
        self._model = model
        self._data = data
        self._read = read
        self._split = split
        self._kept = None
        # What a plugin remembers is its own.
        self._able = not model.nplugin
        self._long = self._rest = 0
        self._next_rest = REST

    def __call__(self) -> None:
        if self._rest or not self._able:
            self._rest = max(self._rest - 1, 0)
            return
        mujoco = self._mujoco
        model = self._model
        data = self._data
        now = time.perf_counter_ns
        if self._kept is None:  # 0.5 ms, enough for once
            self._kept = mujoco.MjData(model)
            return
        begin = now()
        mujoco.mj_copyData(self._kept, model, data)
        try:
            data.warning.number[:] += 1  # MuJoCo tells the first one of each kind only
            if self._split:
                mujoco.mj_step2(model, data)
                mujoco.mj_step1(model, data)
            else:
                mujoco.mj_step(model, data)
        finally:
            mujoco.mj_copyData(data, model, self._kept)
        self._read()
        if now() - begin <= LONGEST_NS:
            self._long = 0
            self._next_rest = REST
            return
        self._long += 1
        if self._long == RUNNING:
            self._long = 0
            self._rest = self._next_rest
            self._next_rest *= 2
