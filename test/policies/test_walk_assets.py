"""Other people's policies walk in MuJoCo, through the importers and the facts that they leave out.

The simulation here is plain mujoco and the policy block, so that a failure is one of the contract.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from unicon_core.policies import Policy, PolicyContract, load_policy, policy_states
from unicon_core.robots import Robot, load_robot
from unicon_core.states import States, standard_states

EVIDENCE = "vendor"
"""What these tests run against, the most that config/evidence.yaml may say by them."""

mujoco = pytest.importorskip("mujoco", reason="the walks need mujoco")
pytest.importorskip("onnxruntime", reason="the policies need onnxruntime")

# The facts that the files do not say, from google-deepmind/mujoco_playground
# `_src/locomotion/go1/joystick.py` and amazon-far/holosoma `config_values/{robot,observation}.py`.
GO1_GIVEN: dict[str, Any] = {
    "period": 0.02,
    "joints": [
        f"{leg}_{joint}_joint"
        for leg in ("FR", "FL", "RR", "RL")
        for joint in ("hip", "thigh", "calf")
    ],
    "default_joint_pos": [0.1, 0.9, -1.8, -0.1, 0.9, -1.8, 0.1, 0.9, -1.8, -0.1, 0.9, -1.8],
    "action.scale": 0.5,
    "stiffness": 35.0,
    "damping": 0.5,
    "observation.terms": [
        {"name": "linvel", "state": "base_lin_vel"},
        {"name": "gyro", "state": "base_ang_vel"},
        {"name": "gravity", "state": "projected_gravity"},
        {"name": "joint_pos", "state": "joint_pos", "subtract": "default_joint_pos"},
        {"name": "joint_vel", "state": "joint_vel"},
        {"name": "last_action", "state": "action"},
        {"name": "command", "state": "velocity_command"},
    ],
}
LEG = [-0.312, 0.0, 0.0, 0.669, -0.363, 0.0]
HOLOSOMA_GIVEN: dict[str, Any] = {
    "period": 0.02,
    "default_joint_pos": [
        *LEG, *LEG, 0.0, 0.0, 0.0,
        0.2, 0.2, 0.0, 0.6, 0.0, 0.0, 0.0, 0.2, -0.2, 0.0, 0.6, 0.0, 0.0, 0.0,
    ],
    "action": {"scale": 0.25, "clip": [-100, 100], "feedback": "clipped"},
    "phase": {"period": 1.0, "offsets": [0.0, np.pi], "stand": np.pi},
    "observation": {
        "terms": [
            {"name": "actions", "state": "action"},
            {"name": "base_ang_vel", "state": "base_ang_vel", "scale": 0.25},
            {"name": "command_ang_vel", "state": "velocity_command", "index": [2]},
            {"name": "command_lin_vel", "state": "velocity_command", "index": [0, 1]},
            {"name": "cos_phase", "state": "gait_phase_cos"},
            {"name": "dof_pos", "state": "joint_pos", "subtract": "default_joint_pos"},
            {"name": "dof_vel", "state": "joint_vel", "scale": 0.05},
            {"name": "projected_gravity", "state": "projected_gravity"},
            {"name": "sin_phase", "state": "gait_phase_sin"},
        ]
    },
}  # fmt: skip


class Simulation:
    """One robot in MuJoCo, driven by the command states with PD torques or position actuators."""

    def __init__(self, model_path: Path, robot: Robot, states: States, step: float) -> None:
        self.model = mujoco.MjModel.from_xml_path(str(model_path))
        self.model.opt.timestep = step
        self.data = mujoco.MjData(self.model)
        self.states = states
        joints = [self.model.joint(name) for name in robot.joint_names]
        self.qpos = np.array([joint.qposadr[0] for joint in joints])
        self.dof = np.array([joint.dofadr[0] for joint in joints])
        actuator_of = {int(self.model.actuator_trnid[i, 0]): i for i in range(self.model.nu)}
        self.actuator = np.array([actuator_of[int(joint.id)] for joint in joints])
        self.limit = np.array([self.model.jnt_actfrcrange[joint.id, 1] for joint in joints])
        self.limit[self.limit == 0] = np.inf
        gain = self.model.actuator_biastype[self.actuator]
        self.position_actuated = bool((gain == mujoco.mjtBias.mjBIAS_AFFINE).all())

    def start(self, contract: PolicyContract, robot: Robot, height: float) -> None:
        self.data.qpos[2] = height
        place = {name: i for i, name in enumerate(robot.joint_names)}
        for name, value in zip(contract.joints, contract.default_joint_pos):
            self.data.qpos[self.qpos[place[name]]] = value
        mujoco.mj_forward(self.model, self.data)

    def recv(self) -> None:
        s, d = self.states, self.data
        s.joint_pos = d.qpos[self.qpos]
        s.joint_vel = d.qvel[self.dof]
        s.base_quat = d.qpos[3:7]
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, d.qpos[3:7])
        rotation = rotation.reshape(3, 3)
        s.base_ang_vel = d.qvel[3:6]
        s.base_lin_vel = rotation.T @ d.qvel[:3]
        s.projected_gravity = -rotation[2]

    def send(self, substeps: int) -> None:
        s, d = self.states, self.data
        for _ in range(substeps):
            if self.position_actuated:
                d.ctrl[self.actuator] = s.joint_pos_target
            else:
                torque = s.joint_stiffness * (s.joint_pos_target - d.qpos[self.qpos])
                torque -= s.joint_damping * d.qvel[self.dof]
                d.ctrl[self.actuator] = np.clip(torque, -self.limit, self.limit)
            mujoco.mj_step(self.model, d)


def walk(
    contract: PolicyContract,
    robot: Robot,
    model: Path,
    command: tuple[float, float, float],
    *,
    height: float,
    step: float,
    seconds: float = 10.0,
) -> tuple[float, float]:
    """Return the distance along x in [m] and the lowest upright component of gravity."""
    states = States(
        {**standard_states(robot.joint_names), **policy_states(contract, robot.joint_names)}
    )
    policy = Policy(contract, states, robot)
    simulation = Simulation(model, robot, states, step)
    simulation.start(contract, robot, height)
    states.velocity_command = command
    upright = 1.0
    policy.reset()
    for _ in range(round(seconds / contract.period)):
        simulation.recv()
        policy()
        simulation.send(round(contract.period / step))
        upright = min(upright, -float(states.projected_gravity[2]))
    return float(simulation.data.qpos[0]), upright


def facts(
    source: str, robot: Robot, assets: Path, given: Mapping[str, Any] | None = None
) -> PolicyContract:
    return load_policy(assets / "policies" / source, robot=robot, given=given)


def test_g1_mjlab_walks_from_its_deploy_yaml(assets: Path) -> None:
    robot = load_robot("g1_29dof")
    contract = facts("g1_velocity_mjlab", robot, assets)
    model = assets / "models" / "g1_29dof" / "g1_29dof.xml"
    distance, upright = walk(contract, robot, model, (0.6, 0.0, 0.0), height=0.79, step=0.002)
    assert upright > 0.8
    assert distance > 4.0


def test_go1_playground_walks_with_the_facts_given(assets: Path) -> None:
    robot = load_robot("go1")
    contract = facts("go1_playground", robot, assets, GO1_GIVEN)
    model = assets / "models" / "go1" / "go1.xml"
    distance, upright = walk(contract, robot, model, (1.0, 0.0, 0.0), height=0.278, step=0.004)
    assert upright > 0.8
    assert distance > 8.0


def test_g1_holosoma_walks_with_the_facts_given(assets: Path) -> None:
    robot = load_robot("g1_29dof")
    contract = facts("g1_holosoma_ppo", robot, assets, HOLOSOMA_GIVEN)
    model = assets / "models" / "g1_29dof" / "g1_29dof.xml"
    distance, upright = walk(contract, robot, model, (0.6, 0.0, 0.0), height=0.76, step=0.002)
    assert upright > 0.8
    assert distance > 2.0


def test_g1_holosoma_stands_while_the_command_is_zero(assets: Path) -> None:
    robot = load_robot("g1_29dof")
    contract = facts("g1_holosoma_ppo", robot, assets, HOLOSOMA_GIVEN)
    model = assets / "models" / "g1_29dof" / "g1_29dof.xml"
    distance, upright = walk(
        contract, robot, model, (0.0, 0.0, 0.0), height=0.76, step=0.002, seconds=4.0
    )
    assert upright > 0.9
    assert abs(distance) < 0.3


def test_g1_mjlab_falls_in_the_order_of_another_robot(assets: Path) -> None:
    """The walk is evidence for the contract: with left and right hips swapped it does not walk."""
    from dataclasses import replace

    robot = load_robot("g1_29dof")
    contract = facts("g1_velocity_mjlab", robot, assets)
    swapped = list(contract.joints)
    left, right = swapped.index("left_hip_pitch_joint"), swapped.index("right_hip_pitch_joint")
    swapped[left], swapped[right] = swapped[right], swapped[left]
    action = replace(contract.action, joints=tuple(swapped))
    wrong = replace(contract, joints=tuple(swapped), action=action)
    model = assets / "models" / "g1_29dof" / "g1_29dof.xml"
    distance, upright = walk(
        wrong, robot, model, (0.6, 0.0, 0.0), height=0.79, step=0.002, seconds=4.0
    )
    assert upright < 0.5 or distance < 1.0
