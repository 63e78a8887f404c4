"""Puts a simulated robot where one was measured, and keeps what its physics go on from."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from unicon_base.arrays import Array
from unicon_core import memory
from unicon_core.models.loaded import import_mujoco
from unicon_core.models.posed import PosedModel
from unicon_core.platforms.mujoco.simulated_robot import SimulatedRobot

# Results of the tick that the next one reads, and `mj_step1` does not compute.
_COMPUTED = ("sensordata", "qacc", "qfrc_actuator")


def put(robot: SimulatedRobot, measured: Mapping[str, Array], posed: PosedModel) -> None:
    """Put a robot where one was measured; commands on their way stay on it.

    Args:
        robot: that is put.
        measured: as of `Placeable`.
        posed: the model on flat ground.
    """
    data, loaded = robot.data, robot.loaded
    if "joint_pos" in measured:
        data.qpos[loaded.addresses] = measured["joint_pos"]
    if "joint_vel" in measured:
        data.qvel[loaded.dofs] = measured["joint_vel"]
    if loaded.base is not None:
        _put_base(robot, loaded.base, measured, posed)
    data.qacc_warmstart[:] = 0.0  # what comes follows from the measured state alone
    robot.forward()


def _put_base(
    robot: SimulatedRobot, base: int, measured: Mapping[str, Array], posed: PosedModel
) -> None:
    mujoco, model, data = import_mujoco(), robot.model, robot.data
    pose = data.qpos[model.jnt_qposadr[base] :][:7]
    twist = data.qvel[model.jnt_dofadr[base] :][:6]
    if "base_quat" in measured:
        pose[3:] = measured["base_quat"]
        mujoco.mju_normalize4(pose[3:])
    if "base_pos_w" in measured:
        pose[:3] = measured["base_pos_w"]
    else:
        posed.put(data.qpos[robot.loaded.addresses], pose)
        pose[2] -= min(posed.heights().values(), default=0.0)
    if "base_ang_vel" in measured:
        twist[3:] = measured["base_ang_vel"]
    if "base_lin_vel" in measured:
        in_base = np.asarray(measured["base_lin_vel"], np.float64)
        mujoco.mju_rotVecQuat(twist[:3], in_base, pose[3:])


def save(robot: SimulatedRobot) -> dict[str, Any]:
    """Return what the physics of a robot go on from."""
    mujoco, model, data = import_mujoco(), robot.model, robot.data
    kind = int(mujoco.mjtState.mjSTATE_INTEGRATION)
    state = np.zeros(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    return {
        **{name: getattr(data, name).copy() for name in _COMPUTED},
        "state": state,
        "ticks": robot.ticks,
        "command": robot.command.copy(),
        "delay": None if robot.delay is None else memory.save(robot.delay),
    }


def load(robot: SimulatedRobot, kept: dict[str, Any]) -> None:
    """Let a robot go on as one of another platform would that was built alike."""
    mujoco, model, data = import_mujoco(), robot.model, robot.data
    mujoco.mj_setState(model, data, kept["state"], int(mujoco.mjtState.mjSTATE_INTEGRATION))
    robot.ticks = kept["ticks"]
    robot.command[...] = kept["command"]
    if robot.delay is not None:
        memory.load(robot.delay, kept["delay"])
    mujoco.mj_step1(model, data)
    for name in _COMPUTED:
        getattr(data, name)[:] = kept[name]
