"""What the tests of motions share: a small robot with a waist, its model, motions and networks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from policy_helpers import robot, write_graph

from unicon_core.models.loaded import import_mujoco
from unicon_core.robots import Robot

# The robot's order is not that of the model, and neither is the policy's.
JOINTS = ("leg", "waist_pitch", "waist_yaw", "arm")
POLICY = ["waist_yaw", "arm", "leg", "waist_pitch"]
MODEL_ORDER = ["waist_yaw", "waist_pitch", "arm", "leg"]

MODEL = """<mujoco><worldbody><body name="pelvis" pos="0 0 0.8"><freejoint/>
<geom type="sphere" size="0.1" mass="5"/>
<body name="waist" pos="0.01 0.02 0.1" quat="0.966 0 0.259 0">
<joint name="waist_yaw" axis="0 0 1"/><geom type="sphere" size="0.05" mass="1"/>
<body name="torso" pos="0 0 0.05"><joint name="waist_pitch" axis="0 1 0" pos="0 0 0.02"/>
<geom type="sphere" size="0.1" mass="3"/><body name="head" pos="0.1 0 0.3" quat="0.7071 0.7071 0 0">
<geom type="sphere" size="0.05" mass="1"/></body>
<body name="hand" pos="0 0.2 0.1"><joint name="arm" axis="1 0 0"/>
<geom type="sphere" size="0.05" mass="1"/></body></body></body>
<body name="foot" pos="0 0 -0.3"><joint name="leg" axis="0 1 0"/>
<geom type="sphere" size="0.05" mass="1"/></body></body></worldbody></mujoco>"""
BODIES = ["pelvis", "waist", "torso", "head", "hand", "foot"]


def waisted() -> Robot:
    """Return the robot; its base is the pelvis."""
    made = robot(JOINTS)
    return type(made)(**{**vars(made), "base_frame": "pelvis"})


def model_in(folder: Path) -> Path:
    """Write the model."""
    path = folder / "waisted.xml"
    path.write_text(MODEL)
    return path


class Kinematics:
    """MuJoCo's own forward kinematics, the slow twin of ours."""

    def __init__(self) -> None:
        mujoco = import_mujoco()
        self.model = mujoco.MjModel.from_xml_string(MODEL)
        self.data = mujoco.MjData(self.model)
        self._forward = mujoco.mj_kinematics

    def __call__(self, pos: Any, quat: Any, joints: dict[str, float]) -> tuple[Any, Any, Any]:
        """Return positions (bodies, 3), quaternions (bodies, 4) and matrices (bodies, 3, 3)."""
        data = self.data
        data.qpos[:7] = (*pos, *quat)
        for name, value in joints.items():
            data.qpos[self.model.joint(name).qposadr[0]] = value
        self._forward(self.model, data)
        return data.xpos[1:].copy(), data.xquat[1:].copy(), data.xmat[1:].reshape(-1, 3, 3).copy()


def motion(frames: int = 40, fps: float = 50.0) -> dict[str, NDArray[np.float64]]:
    """Return a motion with the keys of csv_to_npz.py; joints are in policy order."""
    t = np.arange(frames) / fps
    joints = np.stack([0.3 * np.sin(2.0 * t + k) for k in range(4)], axis=1)
    velocities = np.stack([0.6 * np.cos(2.0 * t + k) for k in range(4)], axis=1)
    heading, lean = 0.9 + 0.8 * t, 0.1 * np.sin(t)
    base_pos = np.stack((1.0 + 0.3 * t, -2.0 + 0.1 * t, 0.8 + 0.02 * np.sin(t)), axis=1)
    turn = np.stack((np.cos(heading / 2), 0 * t, 0 * t, np.sin(heading / 2)), axis=1)
    tip = np.stack((np.cos(lean / 2), 0 * t, np.sin(lean / 2), 0 * t), axis=1)
    base_quat = np.stack([product(a, b) for a, b in zip(turn, tip)])
    kinematics = Kinematics()
    poses = [
        kinematics(pos, quat, dict(zip(POLICY, row)))
        for pos, quat, row in zip(base_pos, base_quat, joints)
    ]
    pos, quat = np.stack([p for p, _, _ in poses]), np.stack([q for _, q, _ in poses])
    return {
        "fps": np.array([fps]), "joint_pos": joints, "joint_vel": velocities,
        "body_pos_w": pos, "body_quat_w": quat,
        "body_lin_vel_w": np.zeros_like(pos), "body_ang_vel_w": np.zeros_like(pos),
    }  # fmt: skip


def product(a: Any, b: Any) -> NDArray[np.float64]:
    """Return the product of two quaternions wxyz, by matrices."""
    w, x, y, z = a
    left = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    return left @ np.asarray(b)


def write_csv(path: Path, moved: dict[str, NDArray[np.float64]]) -> Path:
    """Write the same motion as retargeted files have it: base, quaternion xyzw, joints."""
    quat = moved["body_quat_w"][:, 0][:, [1, 2, 3, 0]]
    rows = np.hstack((moved["body_pos_w"][:, 0], quat, moved["joint_pos"]))
    np.savetxt(path, rows, delimiter=",", fmt="%.9f")
    return path


def write_tracker(path: Path, inputs: int, moved: dict[str, Any] | None, dtype: int = 1) -> None:
    """Write a network of random weights; with a motion it tells that at `time_step`, clamped."""
    weight = np.random.default_rng(3).normal(size=(inputs, 4)).astype(np.float32) * 0.05
    nodes, constants = ["actions = MatMul(obs, w)"], {"w": weight}
    shapes, feeds = {"obs": [1, inputs], "actions": [1, 4]}, ["obs"]
    if moved is not None:
        quat = moved["body_quat_w"][:, 2][:, [1, 2, 3, 0]]  # of the torso, as holosoma has it
        tables = {
            "joint_pos": moved["joint_pos"], "joint_vel": moved["joint_vel"],
            "ref_quat_xyzw": quat, "ref_pos_xyz": moved["body_pos_w"][:, 2],
        }  # fmt: skip
        feeds.append("time_step")
        shapes["time_step"] = [1, 1]
        flat = "flat = Reshape(time_step, one)"
        nodes += [flat, "whole = CastLike(flat, last)", "step = Min(whole, last)"]
        constants |= {"last": np.array([len(quat) - 1]), "one": np.array([1])}
        for name, table in tables.items():
            nodes.append(f"{name} = Gather({name}_all, step)")
            constants[f"{name}_all"] = table
            shapes[name] = [1, table.shape[1]]
    write_graph(path, "\n".join(nodes), feeds, shapes, constants, types={"time_step": dtype})
