"""The kit: each part against its equation, and the platform of the documentation in full."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes import in_scene

from unicon_base.errors import Fault
from unicon_core.platforms.fake import make
from unicon_core.platforms.kit.base import (
    BaseStates,
    Mounting,
    WorldPose,
    quat_of_rpy,
    rotation,
    rpy_of_quat,
)
from unicon_core.platforms.kit.command import Command, Servo
from unicon_core.robots import load_robot
from unicon_core.states import States, standard_states
from unicon_core.states.standard import BASE_STATES, COMMAND_STATES

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "my_robot.py"
UNIT = st.floats(-1.0, 1.0)


def states_of(robot, num_robots=None):
    return States(standard_states(robot.joint_names), num_robots)


def unit(quat):
    quat = np.array(quat, np.float64)
    length = np.linalg.norm(quat)
    return quat / length if length > 0.1 else np.array((1.0, 0.0, 0.0, 0.0))


@given(rpy=st.tuples(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1)))
def test_angles_become_quaternions_and_back(rpy):
    np.testing.assert_allclose(rpy_of_quat(quat_of_rpy(np.array(rpy))), rpy, atol=1e-7)
    several = quat_of_rpy(np.tile(rpy, (5, 1)))
    np.testing.assert_allclose(several, np.tile(quat_of_rpy(np.array(rpy)), (5, 1)))
    roll, pitch, yaw = (rotation(quat_of_rpy(a * np.array(rpy))) for a in np.eye(3))
    turned = rotation(quat_of_rpy(np.array(rpy)))
    np.testing.assert_allclose(turned, yaw @ pitch @ roll, atol=1e-9)


@given(mount=st.tuples(*[UNIT] * 4), base=st.tuples(*[UNIT] * 4), rate=st.tuples(*[UNIT] * 3))
def test_a_turned_sensor_tells_the_same_of_the_base(mount, base, rate):
    mounted = unit(mount)
    base_quat = unit(base)
    base_rate = np.array(rate)
    sensor_to_world = rotation(base_quat) @ rotation(mounted)
    told_rate = rotation(mounted).T @ base_rate
    (w, x, y, z), (a, b, c, d) = base_quat, mounted  # their product is sensor to world
    told = np.array(
        (
            w * a - x * b - y * c - z * d,
            w * b + x * a + y * d - z * c,
            w * c - x * d + y * a + z * b,
            w * d + x * c - y * b + z * a,
        )
    )
    np.testing.assert_allclose(rotation(told), sensor_to_world, atol=1e-9)
    mounting = Mounting(mounted)
    turned = rotation(mounting.quat(told))  # a quaternion and its negative are the same turn
    np.testing.assert_allclose(turned, rotation(base_quat), atol=1e-9)
    np.testing.assert_allclose(mounting.vector(told_rate), base_rate, atol=1e-9)
    readings = {"base_quat": told, "base_ang_vel": told_rate, "base_lin_acc": 2.0 * told_rate}
    mounting.turn(readings, readings)
    np.testing.assert_allclose(rotation(readings["base_quat"]), rotation(base_quat), atol=1e-9)
    np.testing.assert_allclose(readings["base_ang_vel"], base_rate, atol=1e-9)
    np.testing.assert_allclose(readings["base_lin_acc"], 2.0 * base_rate, atol=1e-9)


def test_the_servo_is_the_equation_within_the_limits():
    rng = np.random.default_rng(2)
    rows = rng.uniform(0.0, 3.0, (5, 4))
    limit = np.array([1.0, 5.0, np.nan, 0.5])
    pos, vel = rng.uniform(-1.0, 1.0, (2, 4))
    torque = rows[3] * (rows[0] - pos) + rows[4] * (rows[1] - vel) + rows[2]
    wanted = np.clip(torque, -np.nan_to_num(limit, nan=1e9), np.nan_to_num(limit, nan=1e9))
    np.testing.assert_allclose(Servo(rows, limit)(pos, vel), wanted)


@pytest.mark.parametrize("num_robots", [None, 3])
def test_a_command_is_copied_and_found_finite(num_robots):
    robot = load_robot("go2")
    states = states_of(robot, num_robots)
    command = Command({name: states[name] for name in COMMAND_STATES}, robot.joint_names)
    for i, name in enumerate(COMMAND_STATES):
        states[name] = 1.0 + i
    command.take()
    assert [float(row.min()) for row in command.rows] == [1.0, 2.0, 3.0, 4.0, 5.0]
    states.joint_damping[..., 4] = np.inf
    who = "robot 0, " if num_robots else ""
    with pytest.raises(Fault, match=rf"^{who}joint_damping of joint FL_thigh_joint is inf$"):
        command.take()


def test_base_states_of_a_base_that_turns_and_falls():
    robot = load_robot("go2")
    states = states_of(robot)
    views = {n: states[n][None] for n in BASE_STATES}
    base = BaseStates(views, robot, 0.001, np.array((0.0, 0.0, -9.81)))
    left = np.array([(np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))])  # looks along the world's y
    none = np.zeros((1, 3))
    ahead = np.array([(0.0, 2.0, 0.0)])
    base(*[WorldPose(none, left, ahead, np.array([(0.0, 0.0, 1.0)]))] * 2)
    np.testing.assert_allclose(states.base_lin_vel, (2.0, 0.0, 0.0), atol=1e-6)
    np.testing.assert_allclose(states.base_ang_vel, (0.0, 0.0, 1.0), atol=1e-6)
    np.testing.assert_allclose(states.projected_gravity, (0.0, 0.0, -1.0), atol=1e-6)
    np.testing.assert_allclose(states.base_lin_acc, (0.0, 0.0, 9.81), atol=1e-5)
    falling = np.add(ahead, (0.0, 0.0, -0.00981))
    base(WorldPose(none, left, ahead, none), WorldPose(none, left, falling, none))
    np.testing.assert_allclose(states.base_lin_acc, 0.0, atol=1e-5)


@given(seed=st.integers(0, 2**32 - 1))
def test_a_base_alone_is_told_as_one_of_many(seed):
    rng = np.random.default_rng(seed)
    robot = load_robot("go2")
    poses = []
    for _ in range(2):
        quat = rng.standard_normal((1, 4))
        quat /= np.linalg.norm(quat)
        place, linear, angular = 3.0 * rng.standard_normal((3, 1, 3))
        poses.append(WorldPose(place, quat, linear, angular))
    told = []
    for count in (1, 3):
        states = states_of(robot, count)
        views = {name: states[name] for name in BASE_STATES}
        base = BaseStates(views, robot, 0.002, np.array((0.0, 0.0, -9.81)))
        base(*(WorldPose(*(np.repeat(part, count, axis=0) for part in pose)) for pose in poses))
        told.append(states)
    for name in BASE_STATES:
        for k in range(3):
            np.testing.assert_allclose(told[0][name][0], told[1][name][k], rtol=2e-5, atol=2e-5)


def test_commands_come_late_by_the_delay_and_others_see_them_at_once():
    robot = load_robot("go2")
    states = states_of(robot)
    platform = in_scene(make, states, robot, 0.02, delay=2)
    states.joint_stiffness = 1.0
    arrived = []
    for tick in range(6):
        platform.recv()
        states.joint_pos_target = robot.default_joint_pos + np.float32(0.01 * tick)
        sent = states.joint_pos_target.copy()
        platform.send()
        assert states.joint_pos_target.tolist() == sent.tolist()
        platform.recv()
        arrived.append(float((states.joint_pos - robot.default_joint_pos).max()))
    assert arrived == pytest.approx([0.0, 0.0, 0.0, 0.01, 0.02, 0.03], abs=1e-6)
    states.joint_pos_target[0] = np.nan
    with pytest.raises(Fault, match="is nan"):  # at once, not two ticks later
        platform.send()


class Driver:
    """Stands in for the vendor's."""

    def __init__(self) -> None:
        self.written: list[Any] = []
        self.closed = False

    def read(self) -> Any:
        return np.zeros(12), np.zeros(12), np.array((1.0, 0.0, 0.0, 0.0)), np.zeros(3)

    def write(self, *rows: Any) -> None:
        self.written.append([row.copy() for row in rows])

    def close(self) -> None:
        self.closed = True


def test_the_platform_of_the_documentation_runs(monkeypatch):
    document = (ROOT / "docs" / "reference" / "platforms.md").read_text(encoding="utf-8")
    assert "`examples/my_robot.py`" in document
    driver = Driver()
    vendor = ModuleType("my_vendor")
    vendor.open_driver = lambda port: driver  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "my_vendor", vendor)
    module: dict[str, Any] = {}
    exec(compile(EXAMPLE.read_text(encoding="utf-8"), str(EXAMPLE), "exec"), module)
    robot = load_robot("go2")
    states = states_of(robot)
    platform = module["make"](states, robot, 0.02)
    platform.recv()
    states.joint_pos_target = robot.default_joint_pos
    platform.send()
    assert len(driver.written) == 1
    platform.close()
    assert driver.closed
    assert len(driver.written) > 5
    assert not driver.written[-1][3].any()  # no stiffness at the end
    assert np.isfinite(driver.written[-1]).all()
