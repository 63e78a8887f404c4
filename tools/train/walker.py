"""Runs a policy contract on a MuJoCo model exactly as it is deployed, for `evaluate.py` and tests.

Network at the contract's period, PD with torque clip in every physics step, joints aligned by name.
Needs only numpy, mujoco, onnxruntime and pyyaml.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import contract
import mujoco
import numpy as np
import onnxruntime
import yaml


class Walker:
    """A robot model under the policy's control.

    Attributes:
        torque: joint torques of every physics step of the last tick in [N·m],
            shape (physics steps, n), policy order.
        action: raw output of the network, shape (n,).
        ground: height of the ground under world x, y in [m], shape (n,) of points (n, 2).
        latency: whole control periods by which targets reach the motors late.
    """

    def __init__(self, model: mujoco.MjModel, policy_dir: Path) -> None:
        self.model = model
        self.data = mujoco.MjData(model)
        self.contract: dict[str, Any] = yaml.safe_load((policy_dir / "policy.yaml").read_text())
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        self.session = onnxruntime.InferenceSession(
            str(policy_dir / self.contract["onnx"]), options, providers=["CPUExecutionProvider"]
        )
        joints = [model.joint(name) for name in self.contract["joints"]]
        self.qpos = np.array([joint.qposadr[0] for joint in joints])
        self.qvel = np.array([joint.dofadr[0] for joint in joints])
        actuator_of = {int(model.actuator_trnid[i, 0]): i for i in range(model.nu)}
        self.motors = np.array([actuator_of[joint.id] for joint in joints])
        self.effort = model.actuator_ctrlrange[self.motors, 1]
        self.default = np.array(self.contract["default_joint_pos"])
        self.stiffness = np.array(self.contract["stiffness"])
        self.damping = np.array(self.contract["damping"])
        self.steps = round(self.contract["period"] / model.opt.timestep)
        self.latency = 0
        self.ground: Callable[[np.ndarray], np.ndarray] = lambda points: np.zeros(len(points))
        self.reset()

    def reset(self, height: float = 0.32, yaw: float = 0.0) -> None:
        """Put the robot into the policy's default pose, at rest, its base `height` [m] high."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:7] = [0, 0, height, np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)]
        self.data.qpos[self.qpos] = self.default
        self.action = np.zeros(len(self.default))
        self.memory = {
            given.name: np.zeros((1, given.shape[1]), np.float32)
            for given in self.session.get_inputs()[1:]
        }
        self.pending = deque([self.default] * self.latency)
        mujoco.mj_forward(self.model, self.data)

    def rotation(self) -> np.ndarray:
        """Base to world, shape (3, 3), from the IMU's quaternion."""
        matrix = np.empty(9)
        mujoco.mju_quat2Mat(matrix, self.data.sensor("imu_quat").data)
        return matrix.reshape(3, 3)

    def observation(self, command: np.ndarray) -> np.ndarray:
        """The network's input for `command` (vx, vy [m/s], wz [rad/s]), shape (1, size)."""
        states = {
            "base_ang_vel": self.data.sensor("imu_gyro").data,
            "projected_gravity": -self.rotation()[2],
            "velocity_command": command,
            "joint_pos": self.data.qpos[self.qpos],
            "joint_vel": self.data.qvel[self.qvel],
            "action": self.action,
        }
        parts = []
        for term in self.contract["observation"]["terms"]:
            name = term["state"]
            value = self.height_scan() if name == "height_scan" else states[name]
            subtract = term.get("subtract", 0.0)
            value = value - (self.default if subtract == "default_joint_pos" else subtract)
            if "clip" in term:
                value = np.clip(value, *term["clip"])
            parts.append(term.get("scale", 1.0) * value)
        return np.concatenate(parts).astype(np.float32)[None]

    def height_scan(self) -> np.ndarray:
        """Height of the base above the ground at the points of `contract.SCAN` in [m]."""
        cos, sin = np.cos(self.yaw), np.sin(self.yaw)
        points = self.data.qpos[:2] + contract.SCAN @ np.array([[cos, sin], [-sin, cos]])
        return np.asarray(self.data.qpos[2] - self.ground(points))

    def tick(self, command: np.ndarray) -> None:
        """One control period: observe, infer, then PD in every physics step."""
        given = {"obs": self.observation(command), **self.memory}
        output, *following = self.session.run(None, given)
        self.memory.update(zip(self.memory, following))
        self.action = np.asarray(output[0], dtype=np.float64)
        low, high = self.contract["action"]["clip"]
        scale = self.contract["action"]["scale"]
        self.pending.append(self.default + scale * np.clip(self.action, low, high))
        target = self.pending.popleft()
        self.torque = np.empty((self.steps, len(target)))
        data = self.data
        for i in range(self.steps):
            torque = self.stiffness * (target - data.qpos[self.qpos])
            torque -= self.damping * data.qvel[self.qvel]
            np.clip(torque, -self.effort, self.effort, out=torque)
            data.ctrl[self.motors] = torque
            mujoco.mj_step(self.model, data)
            self.torque[i] = torque
        # Sensors of mj_step belong to the step's beginning; the next observation needs its end.
        mujoco.mj_forward(self.model, data)

    @property
    def yaw(self) -> float:
        """Heading in [rad]."""
        matrix = self.rotation()
        return float(np.arctan2(matrix[1, 0], matrix[0, 0]))

    def velocity(self) -> np.ndarray:
        """Planar base velocity in the heading frame and yaw rate: vx, vy [m/s], wz [rad/s]."""
        vx, vy = self.data.qvel[:2]
        cos, sin = np.cos(self.yaw), np.sin(self.yaw)
        return np.array([cos * vx + sin * vy, cos * vy - sin * vx, self.data.qvel[5]])

    def fallen(self) -> bool:
        """True below 0.15 m or beyond 60 degrees of tilt."""
        return bool(self.data.qpos[2] < 0.15 or self.rotation()[2, 2] < 0.5)
