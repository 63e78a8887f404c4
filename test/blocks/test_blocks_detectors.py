"""Safety blocks that find broken sensors and commands nobody means, and trip for nothing else."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from unicon_base.errors import Fault, WorkflowError
from unicon_core.flow import Stage

Build = Callable[..., Any]


def rest(it):
    """Stand still and level."""
    it.stand()
    it.states.base_quat = (1.0, 0.0, 0.0, 0.0)
    it.states.projected_gravity = (0.0, 0.0, -1.0)
    return it


def tripped(block, change):
    """Tick until a fault; return when it came and what it says."""
    for k in range(500):
        change(k)
        try:
            block.tick()
        except Fault as fault:
            return k, str(fault)
    raise AssertionError("it did not trip")


def test_all_stand_in_stage_safety(bench):
    names = ("range_stop", "command_stop", "encoder_stop", "imu_stop")
    assert {bench().block(name).stage for name in names} == {Stage.SAFETY}


MEASURED = {
    "joint_pos": (np.nan, np.inf, 1e30, -9.0),
    "joint_vel": (np.nan, -np.inf, 500.0),
    "joint_effort": (np.nan, 1e9),
    "base_quat": (np.nan, 1.2),
    "base_ang_vel": (np.nan, 90.0),
    "base_lin_acc": (np.inf,),
    "projected_gravity": (np.nan, -9.81),
}


@pytest.mark.parametrize("state", MEASURED)
@pytest.mark.parametrize("num_robots", [None, 2])
def test_range_stop_names_what_no_robot_measures(bench, state, num_robots):
    for value in MEASURED[state]:
        it = rest(bench(num_robots=num_robots))
        block = it.block("range_stop")
        block.tick()
        it.states[state][..., 1] = value
        who = "robot 0: " if num_robots else ""
        with pytest.raises(Fault, match=rf"^{who}{state} of \w+ is .*not plausible"):
            block.tick()


def test_range_stop_looks_at_what_the_platform_measures(bench):
    from types import SimpleNamespace

    from unicon_core.workflow.autowire import BuildContext, autowire
    from unicon_core.workflow.registry import find_factory

    it = rest(bench())
    facts = SimpleNamespace(writes=("joint_pos", "joint_vel", "stamp_ns"))
    context = BuildContext(it.states, it.robot, it.period, platform=SimpleNamespace(facts=facts))
    block = autowire(find_factory("blocks", "range_stop", WorkflowError), "r", context, {})
    assert block.reads == ("joint_pos", "joint_vel")
    it.states.base_quat = np.nan
    block.tick()
    facts.writes = ("stamp_ns",)
    with pytest.raises(WorkflowError, match="measures nothing"):
        autowire(find_factory("blocks", "range_stop", WorkflowError), "r", context, {})


COMMANDS = {
    "joint_pos_target": (np.nan, 1e6),
    "joint_vel_target": (np.inf, 1e6),
    "joint_effort_ff": (np.nan, -1e6),
    "joint_stiffness": (np.nan, 1e9, -50.0, -0.1),
    "joint_damping": (1e4, -50.0),
}


@pytest.mark.parametrize("state", COMMANDS)
def test_command_stop_names_what_nobody_means(bench, state):
    for value in COMMANDS[state]:
        it = rest(bench("g1_29dof"))
        block = it.block("command_stop")
        block.tick()
        it.states[state][28] = value
        with pytest.raises(Fault, match=rf"^{state} of {it.robot.joint_names[28]} is .*plausible"):
            block.tick()


def test_plain_values_pass_and_stay_as_they_are(bench):
    it = rest(bench())
    blocks = [it.block("range_stop"), it.block("command_stop")]
    robot = it.robot

    @settings(max_examples=60, deadline=None, derandomize=True)
    @given(seed=st.integers(0, 2**32 - 1))
    def holds(seed: int) -> None:
        rng = np.random.default_rng(seed)
        s = it.states
        s.joint_pos = rng.uniform(robot.lower - 0.4, robot.upper + 0.4)
        s.joint_vel = rng.uniform(-2, 2, 12) * robot.velocity_limit
        quat = rng.normal(size=4)
        s.base_quat = quat / np.linalg.norm(quat)
        s.base_ang_vel = rng.uniform(-60, 60, 3)
        s.base_lin_acc = rng.uniform(-1e4, 1e4, 3)
        s.joint_pos_target = rng.uniform(-20, 20, 12)
        s.joint_stiffness = rng.choice([0.0, 2000.0], 12)
        s.joint_damping = rng.choice([0.0, 200.0], 12)
        s.joint_effort_ff = rng.uniform(-2, 2, 12) * robot.effort_limit
        before = s.snapshot().data
        for block in blocks:
            block.tick()
        assert s.snapshot().data == before

    holds()


def test_encoder_stop_waits_for_motion(bench):
    it = rest(bench())
    block = it.block("encoder_stop")
    for _ in range(50):  # nothing moves, nothing is asked
        block.tick()
    for k in range(50):  # what follows its target is there
        it.states.joint_pos_target = it.robot.default_joint_pos + 0.01 * k
        it.states.joint_pos = it.robot.default_joint_pos + 0.01 * k - 0.02
        block.tick()
    joint = it.robot.joint_names[4]

    def stuck(k: int) -> None:
        moving = it.robot.default_joint_pos + 0.5 + 0.01 * k
        it.states.joint_pos_target = moving
        moving[4] = it.states.joint_pos[4]
        it.states.joint_pos = moving

    k, fault = tripped(block, stuck)
    assert k <= 14  # 0.1 rad at 0.01 a tick, and a few
    assert f"joint {joint} is stuck: its position has been" in fault
    block.reset()
    block.tick()


def test_a_limp_joint_is_not_asked_to_move(bench):
    it = rest(bench())
    it.states.joint_stiffness = 0.0
    block = it.block("encoder_stop")
    for k in range(50):
        it.states.joint_pos_target = 0.05 * k
        block.tick()


def turning(it, rate, k, *, frozen=False):
    """Roll about x at a rate in [rad/s] as the IMU tells of it in tick k."""
    angle = 0.0 if frozen else 0.5 * np.sin(rate * 0.02 * k)
    speed = 0.5 * rate * np.cos(rate * 0.02 * k)
    it.states.base_quat = (np.cos(angle / 2), np.sin(angle / 2), 0.0, 0.0)
    it.states.projected_gravity = (0.0, -np.sin(angle), -np.cos(angle))
    it.states.base_ang_vel = (speed, 0.0, 0.0)
    it.states.stamp_ns = 20_000_000 * k
    it.states.joint_pos = it.robot.default_joint_pos + 0.1 * np.sin(0.3 * k)


def test_imu_stop_lets_a_base_turn(bench):
    for rate in (1.0, 5.0, 12.0):
        it = rest(bench())
        block = it.block("imu_stop")
        for k in range(500):
            turning(it, rate, k)
            block.tick()


def test_imu_stop_finds_an_orientation_that_does_not_turn(bench):
    it = rest(bench())
    block = it.block("imu_stop")
    k, fault = tripped(block, lambda k: turning(it, 4.0, k, frozen=True))
    assert k < 100
    assert "base_quat has the same bits while the gyroscope turned by 0.3" in fault


def test_imu_stop_finds_a_quaternion_that_turns_about_another_axis(bench):
    it = rest(bench())
    block = it.block("imu_stop")

    def heading(k: int) -> None:  # of the quaternion alone goes on
        turning(it, 4.0, k, frozen=True)
        it.states.base_quat = (np.cos(0.01 * k), 0.0, 0.0, np.sin(0.01 * k))

    k, fault = tripped(block, heading)
    assert k < 20
    assert "base_quat turned otherwise than the gyroscope says" in fault


def test_imu_stop_finds_a_frozen_quaternion_of_a_base_that_turns_about_the_vertical(bench):
    it = rest(bench())
    block = it.block("imu_stop")

    def yawing(k: int) -> None:
        it.states.base_ang_vel = (0.0, 0.0, 0.5 + 1e-3 * k)

    k, fault = tripped(block, yawing)
    assert 30 <= k < 40  # 0.35 rad at 0.5 rad/s
    assert "is base_quat frozen?" in fault


def test_imu_stop_lets_a_base_rest_and_an_imu_be_late(bench):
    it = rest(bench())
    block = it.block("imu_stop")
    for k in range(3000):
        it.states.base_ang_vel = (0.01 * np.sin(k), 0.01, 0.0)  # noise and offset
        block.tick()
    for k in range(60):
        turning(it, 5.0, 6 * (k // 6))  # every sixth tick has news
        block.tick()


def test_imu_stop_finds_frozen_bits_while_joints_move(bench):
    it = rest(bench())
    block = it.block("imu_stop")
    for _ in range(100):  # nothing moves
        block.tick()

    def moving(k: int) -> None:
        it.states.joint_pos = it.robot.default_joint_pos + 0.1 * np.sin(0.3 * k)

    k, fault = tripped(block, moving)
    assert k < 20
    assert "the IMU stands still: the same bits" in fault


def test_imu_stop_finds_gravity_that_the_quaternion_denies(bench):
    it = rest(bench())
    block = it.block("imu_stop")
    block.tick()
    it.states.projected_gravity = (0.0, 0.0, 1.0)
    k, fault = tripped(block, lambda _: None)
    assert k < 3  # every second tick is enough at a time-out of ten
    assert "contradicts itself: gravity by base_quat" in fault


def test_imu_stop_is_for_one_robot(bench):
    with pytest.raises(WorkflowError, match="one robot"):
        bench(num_robots=2).block("imu_stop")
