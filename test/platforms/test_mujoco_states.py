"""What `recv` writes is the simulator's own state at the end of the tick, by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest

from unicon_core.platforms.mujoco import MujocoPlatform, make
from unicon_core.robots import load_robot
from unicon_core.states import States, standard_states

Build = Callable[..., tuple[MujocoPlatform, States]]


def rotation(quat):
    """R(q), base to world, of a quaternion wxyz; the textbook matrix."""
    w, x, y, z = np.asarray(quat, np.float64) / np.linalg.norm(quat)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def tumble(platform, ticks=20):
    """Let the box fly and turn about all axes."""
    free = platform.model.jnt_dofadr[1]
    platform.data.qvel[free : free + 6] = (0.5, -0.3, 2.0, 1.0, -2.0, 1.5)
    for _ in range(ticks):
        platform.send()
    platform.recv()


def base_truth(platform):
    model = platform.model
    data = platform.data
    qpos = data.qpos[model.jnt_qposadr[1] :]
    qvel = data.qvel[model.jnt_dofadr[1] :]
    turn = rotation(qpos[3:7])
    return {
        "base_quat": qpos[3:7],
        "base_pos_w": qpos[:3],
        "base_lin_vel": turn.T @ qvel[:3],
        "base_ang_vel": qvel[3:6],
        "projected_gravity": turn.T @ (0.0, 0.0, -1.0),
    }


SITES = ["", 'euler="0.3 -0.7 1.1"']


@pytest.mark.parametrize("site", SITES)
@pytest.mark.parametrize("with_sensors", [True, False])
def test_base_states_are_those_of_the_base_whatever_the_imu(build, site, with_sensors):
    options: dict[str, Any] = {"site": site} if with_sensors else {"site": site, "sensors": ""}
    platform, states = build(model=options)
    tumble(platform)
    sources = set(platform.info()["imu"].values())
    assert sources == ({"imu_quat", "imu_gyro", "imu_acc"} if with_sensors else {"free joint"})
    for name, truth in base_truth(platform).items():
        np.testing.assert_allclose(states[name], truth, atol=1e-6, err_msg=name)


@pytest.mark.parametrize("integrator", ["Euler", "RK4", "implicitfast"])
def test_sensors_are_fresh_at_the_end_of_the_tick(build, integrator):
    """A gyro read after a plain mj_step would lag by one physics step."""
    platform, states = build(model={"integrator": integrator})
    tumble(platform)
    truth = base_truth(platform)
    np.testing.assert_allclose(states.base_ang_vel, truth["base_ang_vel"], rtol=1e-6)


MANY = """
    <accelerometer site="imu"/> <gyro site="imu"/> <force site="imu"/> <touch site="imu"/>
    <jointpos joint="elbow_joint"/> <actuatorfrc actuator="b"/> <clock/>
    <framelinacc objtype="body" objname="ball"/> <subtreelinvel body="box"/>
"""


@pytest.mark.parametrize("integrator", ["Euler", "RK4", "implicitfast"])
@pytest.mark.parametrize("period", [0.002, 0.004, 0.02])
@pytest.mark.parametrize("late", [{}, {"joints": {"*": {"delay": 0.006}}}])
def test_sensors_of_the_last_step_are_those_of_every_step(build, integrator, period, late):
    told = []
    for every in (False, True):
        model = {"integrator": integrator, "sensors": MANY}
        platform, states = build(period, model=model, **late)
        (robot,) = platform.robots
        assert robot._unseen == mujoco.mjtDisableBit.mjDSBL_SENSOR
        if every:
            robot._unseen = 0
        flags = platform.model.opt.disableflags
        data = platform.data
        data.qpos[2] = 0.1  # the ball touches the floor
        states.joint_stiffness = 20.0
        for tick in range(5):
            states.joint_pos_target = 0.2 * tick
            tumble(platform, 1)
        assert platform.model.opt.disableflags == flags
        names = ("qpos", "qvel", "qacc", "qfrc_actuator", "sensordata", "cfrc_int")
        told.append([np.array(getattr(data, name)) for name in names])
    for seldom, always in zip(*told):
        assert (seldom == always).all()


def test_sensors_that_remember_are_reckoned_in_every_step(build):
    if not hasattr(mujoco.MjModel, "sensor_interval"):
        pytest.skip("this MuJoCo has no such sensors: pip install -U mujoco")
    sensors = '<gyro site="imu" interval="0.004" nsample="3"/>'
    platform, _ = build(model={"sensors": sensors})
    assert platform.robots[0]._unseen == 0


@pytest.mark.parametrize("with_sensors", [True, False])
def test_accelerometer_reads_zero_in_flight_and_one_g_at_rest(build, with_sensors):
    model: dict[str, Any] = {} if with_sensors else {"sensors": ""}
    platform, states = build(model=model)
    platform.recv()
    np.testing.assert_allclose(states.base_lin_acc, 0.0, atol=1e-5)
    go2 = load_robot("go2")
    states_go2 = States(standard_states(go2.joint_names))
    standing = make(states_go2, go2, 0.02)
    states_go2.joint_pos_target = go2.default_joint_pos
    states_go2.joint_stiffness = go2.joint_stiffness
    states_go2.joint_damping = go2.joint_damping
    for _ in range(100):
        standing.send()
    standing.recv()
    assert np.linalg.norm(states_go2.base_lin_acc) == pytest.approx(9.81, abs=0.05)
    assert states_go2.projected_gravity[2] < -0.99
    assert 0.25 < states_go2.base_pos_w[2] < 0.32


def test_joints_are_matched_by_name(build):
    platform, states = build()
    for i, name in enumerate(("shoulder", "elbow", "wrist", "finger")):
        joint = platform.model.joint(f"{name}_joint")
        platform.data.qpos[joint.qposadr] = 0.1 * (i + 1)
        platform.data.qvel[joint.dofadr] = -0.2 * (i + 1)
    platform.recv()
    np.testing.assert_allclose(states.joint_pos, (0.1, 0.2, 0.3, 0.4), rtol=1e-6)
    np.testing.assert_allclose(states.joint_vel, (-0.2, -0.4, -0.6, -0.8), rtol=1e-6)


@pytest.mark.parametrize(
    ("timestep", "period"), [(0.002, 0.02), (1 / 300, 1 / 30), (0.0007, 0.0021), (0.004, 0.02)]
)
def test_time_stamps_do_not_drift(build, timestep, period):
    platform, states = build(period, timestep=timestep)
    platform.recv()
    assert states.stamp_ns == 0
    robot = platform.robots[0]
    for ticks in (1, 7, 10**6, 10**9):
        robot.ticks = ticks
        platform.recv()
        # A rate of 1/3 is itself a rounded number: 1e-16 of the time is what it can be off.
        assert abs(int(states.stamp_ns) - ticks * period * 1e9) <= 1 + 4e-16 * ticks * period * 1e9


def test_reset_repeats_the_run_bit_for_bit(build):
    platform, states = build(noise={"joint_pos": 0.01}, seed=3)
    runs = []
    for _ in range(2):
        platform.reset()
        trace = []
        for tick in range(20):
            platform.recv()
            states.joint_effort_ff = 0.1 * tick
            platform.send()
            trace.append(states.snapshot().data)
        runs.append(trace)
    assert runs[0] == runs[1]


def test_every_robot_of_a_batch_equals_a_run_of_its_own(build):
    rng = np.random.default_rng(4)
    commands = rng.uniform(0, 2, (15, 5, 3, 4)).astype(np.float32)  # tick, state, robot, joint
    batch, many = build(num_robots=3)
    names = batch.facts.reads
    trace = []
    for command in commands:
        batch.recv()
        trace.append({name: many[name].copy() for name in batch.facts.writes})
        for name, value in zip(names, command):
            many[name] = value
        batch.send()
    for k in range(3):
        single, states = build()
        for tick, command in enumerate(commands):
            single.recv()
            for name in single.facts.writes:
                assert states[name].tobytes() == trace[tick][name][k].tobytes(), (k, tick, name)
            for name, value in zip(names, command):
                states[name] = value[k]
            single.send()


def test_noise_has_the_given_spread_and_quaternions_stay_unit(build):
    platform, states = build(noise={"joint_vel": 0.5, "base_quat": 0.05}, seed=1)
    readings = []
    norms = []
    for _ in range(500):
        platform.recv()
        readings.append(states.joint_vel.copy())
        norms.append(float(np.linalg.norm(states.base_quat)))
    assert np.std(readings) == pytest.approx(0.5, rel=0.1)
    np.testing.assert_allclose(norms, 1.0, atol=1e-6)
    assert states.base_ang_vel.tolist() == [0.0, 0.0, 0.0]


def test_pushes_move_the_base_at_their_times_only(build):
    velocities = []
    for options in ({}, {"push": {"every": 0.05, "velocity": 1.0}, "seed": 5}):
        platform, states = build(**options)
        velocities.append([])
        for _ in range(12):
            platform.recv()
            velocities[-1].append(states.base_lin_vel.copy())
            platform.send()
    pushed = np.subtract(*velocities)
    jumps = np.linalg.norm(np.diff(pushed, axis=0), axis=1)
    assert pushed[:6].max() == 0.0
    assert {int(i) for i in np.argsort(jumps)[-2:]} == {5, 10}  # the pushes come in these ticks


def test_fixed_base_leaves_the_base_states_alone(build):
    platform, states = build(model={"base": ""})
    platform.send()
    platform.recv()
    assert platform.info()["base"] is None
    assert not {"base_quat", "base_pos_w"} & set(platform.facts.writes)
    assert states.base_quat.tolist() == [1.0, 0.0, 0.0, 0.0]
    assert states.joint_vel.any()


def test_initial_pose_stands_on_the_floor(build):
    platform, states = build()
    platform.recv()
    np.testing.assert_allclose(states.joint_pos, 0.1, rtol=1e-6)
    model = platform.model
    data = platform.data
    floor = model.geom("floor").id
    gaps = [
        mujoco.mj_geomDistance(model, data, floor, i, 10.0, None)
        for i in range(model.ngeom)
        if model.body_rootid[model.geom_bodyid[i]] == model.body("box").id
    ]
    assert min(gaps) == pytest.approx(0.0005, abs=1e-6)


@pytest.mark.parametrize(
    ("options", "pos", "base"),
    [
        ({"initial_pose": "rest", "initial_height": 1.5}, [-0.1] * 4, (0, 0, 1.5)),
        ({"initial_pose": {"wrist_joint": 1.0}, "initial_height": 1.0}, [0.1, 0.1, 1.0, 0.1], None),
        ({"initial_pose": "model"}, [0.0] * 4, (0, 0, 2)),
        ({"initial_pose": "keyframe:up"}, [0.1, 0.2, 0.3, 0.4], (1, 2, 3)),
    ],
)
def test_initial_pose_can_be_chosen(build, options, pos, base):
    platform, states = build(**options)
    platform.recv()
    np.testing.assert_allclose(states.joint_pos, pos, rtol=1e-6, atol=1e-9)
    if base:
        np.testing.assert_allclose(states.base_pos_w, base, rtol=1e-6, atol=1e-9)


def test_info_names_joints_beyond_the_robots(build):
    notes = build()[0].info()["notes"]
    assert any("joints beyond the robot's" in note for note in notes)
