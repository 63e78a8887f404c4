"""The servo that MuJoCo computes is the PD equation in NumPy, for every kind of actuator."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import in_scene

from unicon_core.platforms.mujoco import MujocoPlatform, make
from unicon_core.robots import Robot
from unicon_core.states import States

# Tightest of robot file 9, control range 4 x gear 3, joint 6, force range 5: in JOINTS' order.
LIMIT = np.array([9.0, 6.0, 9.0, 5.0])
TARGET_RANGE = {2: 1.5}  # the position actuator of the wrist clips its targets


def pd_torque(command, pos, vel):
    """tau = kp (q* - q) + kd (qd* - qd) + tau_ff, clipped; rows as in COMMAND_STATES."""
    target = np.array(command[0])
    for joint, bound in TARGET_RANGE.items():
        target[joint] = np.clip(target[joint], -bound, bound)
    torque = command[3] * (target - pos) + command[4] * (command[1] - vel) + command[2]
    return np.clip(torque, -LIMIT, LIMIT)


def send_command(states, command):
    names = ("joint_pos_target", "joint_vel_target", "joint_effort_ff")
    for name, row in zip((*names, "joint_stiffness", "joint_damping"), command):
        states[name] = row


def random_command(rng, count, strength=1.0):
    """Commands in float32, as the states carry them, in float64 for the equation."""
    rows = [
        rng.uniform(-2, 2, count),
        rng.uniform(-3, 3, count),
        rng.uniform(-2, 2, count) * strength,
        rng.uniform(0, 30, count) * strength,
        rng.uniform(0, 1, count) * strength,
    ]
    return np.array(rows, np.float32).astype(np.float64)


class Toy:
    def __init__(self, platform: MujocoPlatform, states: States, robot: Robot) -> None:
        self.platform = platform
        self.states = states
        self.robot = robot
        self.model = platform.model
        self.data = platform.data
        ids = [self.model.joint(name).id for name in robot.joint_names]
        self.qpos = [int(self.model.jnt_qposadr[i]) for i in ids]
        self.dof = [int(self.model.jnt_dofadr[i]) for i in ids]


@pytest.fixture
def toy(toy_robot, toy_model, states_of):
    def build(period: float = 0.002, integrator: str = "implicitfast", **options: Any) -> Toy:
        robot = toy_robot()
        states = states_of(robot)
        model = toy_model(integrator=integrator)
        return Toy(in_scene(make, states, robot, period, model=model, **options), states, robot)

    return build


def test_torque_equals_the_equation_for_every_kind_of_actuator(toy):
    it = toy()
    assert it.platform.info()["actuators"] == {
        "shoulder_joint": "motor",
        "elbow_joint": "general",
        "wrist_joint": "position",
        "finger_joint": "velocity",
    }
    clipped: set[bool] = set()

    @settings(max_examples=60, deadline=None, derandomize=True)
    @given(seed=st.integers(0, 2**32 - 1), strength=st.sampled_from([0.1, 1.0, 5.0]))
    def holds(seed: int, strength: float) -> None:
        rng = np.random.default_rng(seed)
        it.platform.reset()
        it.data.qpos[it.qpos] = rng.uniform(-1.5, 1.5, 4)
        it.data.qvel[it.dof] = rng.uniform(-8, 8, 4)
        mujoco.mj_step1(it.model, it.data)
        pos = it.data.qpos[it.qpos].copy()
        vel = it.data.qvel[it.dof].copy()
        command = random_command(rng, 4, strength)
        send_command(it.states, command)
        it.platform.send()
        expected = pd_torque(command, pos, vel)
        np.testing.assert_allclose(it.data.qfrc_actuator[it.dof], expected, rtol=0, atol=1e-9)
        it.platform.recv()
        np.testing.assert_allclose(it.states.joint_effort, expected, rtol=1e-6)
        clipped.update((np.abs(expected) == LIMIT).tolist())

    holds()
    assert clipped == {True, False}  # both sides of the limits were seen


def test_ticks_equal_explicit_pd_in_every_physics_step(toy):
    """With an explicit integrator whole trajectories equal those of a Python PD loop."""
    it = toy(period=0.01, integrator="Euler")
    twin_model = mujoco.MjModel.from_xml_path(it.platform.info()["model"])
    twin_model.actuator_gainprm[:] = twin_model.actuator_biasprm[:] = 0.0
    twin = mujoco.MjData(twin_model)
    twin.qpos[:] = it.data.qpos
    rng = np.random.default_rng(1)
    for _ in range(30):
        command = random_command(rng, 4)
        send_command(it.states, command)
        it.platform.send()
        for _ in range(it.platform.decimation):
            torque = pd_torque(command, twin.qpos[it.qpos], twin.qvel[it.dof])
            twin.qfrc_applied[it.dof] = torque
            mujoco.mj_step(twin_model, twin)
        np.testing.assert_allclose(it.data.qpos, twin.qpos, rtol=0, atol=1e-9)
        np.testing.assert_allclose(it.data.qvel, twin.qvel, rtol=0, atol=1e-7)
    assert it.platform.decimation == 5


def test_gains_may_change_in_every_tick(toy):
    it = toy()
    rng = np.random.default_rng(2)
    for tick in range(20):
        pos = it.data.qpos[it.qpos].copy()
        vel = it.data.qvel[it.dof].copy()
        command = random_command(rng, 4)
        if tick % 2:
            command[3] = 0.0  # damping only
        send_command(it.states, command)
        it.platform.send()
        expected = pd_torque(command, pos, vel)
        np.testing.assert_allclose(it.data.qfrc_actuator[it.dof], expected, rtol=0, atol=1e-9)


def test_effort_limits_are_the_tightest_of_all(toy):
    info = toy().platform.info()
    assert list(info["effort_upper"].values()) == LIMIT.tolist()
    assert list(info["effort_lower"].values()) == (-LIMIT).tolist()


def test_commands_act_after_the_delay(toy):
    it = toy(delay=3)
    sent = []
    applied = []
    for tick in range(10):
        command = np.zeros((5, 4))
        command[2] = 0.1 * (tick + 1)
        sent.append(command[2, 0])
        send_command(it.states, command)
        it.platform.send()
        it.platform.recv()
        applied.append(float(it.states.joint_effort[0]))
    np.testing.assert_allclose(applied[:3], [0.1] * 3, rtol=1e-6)  # the first command is held
    np.testing.assert_allclose(applied[3:], sent[:-3], rtol=1e-6)
