"""Puts a simulated robot where one was measured, and keeps what its physics go on from."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.memory import load, save
from unicon_core.models.loaded import LoadedModel, import_mujoco
from unicon_core.models.posed import PosedModel
from unicon_core.platforms.sim.mujoco.simulated_robot import SimulatedRobot

_COMPUTED = ("sensordata", "qacc", "qfrc_actuator")
"""Results of the tick that the next one reads, and `mj_step1` does not compute."""


class Placement:
    """The robots of a platform and where they are.

    Args:
        loaded: the model.
        robots: that are put.
    """

    def __init__(self, loaded: LoadedModel, robots: list[SimulatedRobot]) -> None:
        self._mujoco, self._loaded, self._robots = import_mujoco(), loaded, robots
        model = loaded.model
        self._addresses = {
            "joint_pos": ("qpos", model.jnt_qposadr[loaded.joints]),
            "joint_vel": ("qvel", model.jnt_dofadr[loaded.joints]),
        }
        self._base, self._posed = loaded.base, PosedModel(loaded)
        self._kind = int(self._mujoco.mjtState.mjSTATE_INTEGRATION)

    def put(self, measured: Mapping[str, NDArray[Any]]) -> None:
        """Put every robot where one was measured; commands on their way stay on it."""
        for robot in self._robots:
            data = robot.data
            for name, (array, addresses) in self._addresses.items():
                if name in measured:
                    getattr(data, array)[addresses] = measured[name]
            if self._base is not None:
                self._put_base(data, self._base, measured)
            data.qacc_warmstart[:] = 0.0  # what comes follows from the measured state alone
            robot.forward()

    def _put_base(self, data: Any, base: int, measured: Mapping[str, NDArray[Any]]) -> None:
        mujoco, model = self._mujoco, self._loaded.model
        pose = data.qpos[model.jnt_qposadr[base] :][:7]
        twist = data.qvel[model.jnt_dofadr[base] :][:6]
        if "base_quat" in measured:
            pose[3:] = measured["base_quat"]
            mujoco.mju_normalize4(pose[3:])
        if "base_pos_w" in measured:
            pose[:3] = measured["base_pos_w"]
        else:
            self._posed.put(data.qpos[self._loaded.addresses], pose)
            pose[2] -= min(self._posed.heights().values(), default=0.0)
        if "base_ang_vel" in measured:
            twist[3:] = measured["base_ang_vel"]
        if "base_lin_vel" in measured:
            in_base = np.asarray(measured["base_lin_vel"], np.float64)
            mujoco.mju_rotVecQuat(twist[:3], in_base, pose[3:])

    def save(self) -> list[dict[str, Any]]:
        """Return what the physics of each robot go on from."""
        return [self._save(robot) for robot in self._robots]

    def _save(self, robot: SimulatedRobot) -> dict[str, Any]:
        state = np.zeros(self._mujoco.mj_stateSize(robot.model, self._kind))
        self._mujoco.mj_getState(robot.model, robot.data, state, self._kind)
        found = {name: getattr(robot.data, name).copy() for name in _COMPUTED}
        return {
            **found,
            "state": state,
            "ticks": robot.ticks,
            "command": robot.command.copy(),
            "delay": None if robot.delay is None else save(robot.delay),
        }

    def load(self, saved: list[dict[str, Any]]) -> None:
        """Go on as the robots of another platform would that was built alike."""
        for robot, kept in zip(self._robots, saved, strict=True):
            self._mujoco.mj_setState(robot.model, robot.data, kept["state"], self._kind)
            robot.ticks = kept["ticks"]
            robot.command[...] = kept["command"]
            if robot.delay is not None:
                load(robot.delay, kept["delay"])
            self._mujoco.mj_step1(robot.model, robot.data)
            for name in _COMPUTED:
                getattr(robot.data, name)[:] = kept[name]
