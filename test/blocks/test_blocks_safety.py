"""Safety blocks: what they clip, when they stop, and that they leave good commands alone."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from unicon_base.errors import Fault, RobotError, WorkflowError
from unicon_core.flow import Stage

Bench = Any
Build = Callable[..., Bench]

SAFETY = (
    "joint_limits",
    "effort_limits",
    "rate_limit",
    "velocity_limits",
    "finite",
    "tilt_stop",
    "velocity_stop",
    "stale_stop",
    "fade_in",
)


def test_all_stand_in_stage_safety(bench):
    assert {bench().block(name).stage for name in SAFETY} == {Stage.SAFETY}


def test_joint_limits_clip_in_place(bench):
    it = bench()
    it.states.joint_pos_target = 9.0
    block = it.block("joint_limits", margin=0.1)
    block.tick()
    np.testing.assert_allclose(it.states.joint_pos_target, it.robot.upper - 0.1, rtol=1e-6)
    it.states.joint_pos_target = -9.0
    block.tick()
    np.testing.assert_allclose(it.states.joint_pos_target, it.robot.lower + 0.1, rtol=1e-6)
    assert block.amends == ("joint_pos_target",)
    it.stand()
    before = it.states.snapshot().data
    block.tick()
    assert it.states.snapshot().data == before


def servo_torque(states):
    """tau = kp (q* - q) + kd (qd* - qd) + tau_ff in float64."""
    s = {name: states[name].astype(np.float64) for name in states}
    return (
        s["joint_stiffness"] * (s["joint_pos_target"] - s["joint_pos"])
        + s["joint_damping"] * (s["joint_vel_target"] - s["joint_vel"])
        + s["joint_effort_ff"]
    )


def test_effort_limits_leave_the_clipped_torque(bench):
    it = bench()
    block = it.block("effort_limits", scale=0.5)
    limit = 0.5 * it.robot.effort_limit.astype(np.float64)
    seen: set[bool] = set()

    @settings(max_examples=80, deadline=None, derandomize=True)
    @given(seed=st.integers(0, 2**32 - 1), limp=st.booleans())
    def holds(seed: int, limp: bool) -> None:
        it.randomize(np.random.default_rng(seed))
        if limp:
            it.states.joint_stiffness[::2] = 0.0
            it.states.joint_effort_ff *= 20.0
        wanted = servo_torque(it.states)
        before = it.states.joint_pos_target.copy(), it.states.joint_effort_ff.copy()
        block.tick()
        np.testing.assert_allclose(
            servo_torque(it.states), np.clip(wanted, -limit, limit), rtol=1e-4, atol=1e-3
        )
        inside = np.abs(wanted) < limit * 0.9999
        for name, old in zip(("joint_pos_target", "joint_effort_ff"), before):
            assert it.states[name][inside].tolist() == old[inside].tolist()
        seen.update(inside.tolist())

    holds()
    assert seen == {True, False}


def test_rate_limit_bounds_the_speed_of_targets(bench):
    it = bench()
    it.states.joint_pos = 0.1
    block = it.block("rate_limit", max_rate=5.0)
    targets = []
    for _ in range(20):
        it.states.joint_pos_target = 1.0
        block.tick()
        targets.append(float(it.states.joint_pos_target[0]))
    np.testing.assert_allclose(targets, np.minimum(0.1 + 0.1 * np.arange(1, 21), 1.0), rtol=1e-5)
    block.reset()
    it.states.joint_pos = -1.0
    block.tick()
    assert it.states.joint_pos_target[0] == pytest.approx(-0.9)
    it.states.joint_pos_target = -3.0
    block.tick()
    assert it.states.joint_pos_target[0] == pytest.approx(-1.0)


def test_fade_in_scales_the_stiffness_then_stops(bench):
    it = bench()
    block = it.block("fade_in", duration=0.2)
    scales = []
    for _ in range(12):
        it.states.joint_stiffness = 50.0
        block.tick()
        scales.append(float(it.states.joint_stiffness[3]))
    np.testing.assert_allclose(scales, [5 * min(k, 10) for k in range(1, 13)], rtol=1e-6)


def test_fade_in_scales_velocities_and_torques_once(bench):
    it = bench()
    block = it.block("fade_in", duration=0.1)
    names = ("joint_vel_target", "joint_effort_ff")
    seen = []
    for tick in range(7):
        if tick % 2 == 0:  # a policy that runs in every other tick
            for name in names:
                it.states[name] = 10.0
        block.tick()
        assert it.states[names[0]].tolist() == it.states[names[1]].tolist()
        seen.append(float(it.states[names[0]][3]))
    np.testing.assert_allclose(seen, [2.0, 4.0, 6.0, 8.0, 10.0, 10.0, 10.0], rtol=1e-6)
    block.reset()
    block.tick()
    assert it.states[names[0]][3] == pytest.approx(2.0)


def test_velocity_limits_clamp_or_trip(bench):
    it = bench()
    block = it.block("velocity_limits")
    stop = it.block("velocity_limits", beyond="trip")
    limit = it.robot.velocity_limit
    it.states.joint_vel_target = 0.5 * limit
    stop.tick()
    block.tick()
    assert it.states.joint_vel_target.tolist() == (np.float32(0.5) * limit).tolist()
    for beyond in (1.1, -1.1):
        it.states.joint_vel_target = 0.5 * limit
        it.states.joint_vel_target[2] = beyond * limit[2]
        with pytest.raises(Fault, match="joint FR_calf_joint is sent a velocity of"):
            stop.tick()
        block.tick()
        assert it.states.joint_vel_target[2] == np.sign(beyond) * limit[2]
    it.states.joint_vel_target[2] = -1e4
    with pytest.raises(Fault) as error:
        stop.tick()
    assert str(error.value) == (
        f"joint FR_calf_joint is sent a velocity of -10000.00 rad/s, allowed are {limit[2]:.2f}"
    )
    block.tick()
    assert it.states.joint_vel_target[2] == -limit[2]
    stop.tick()
    it.states.joint_vel_target[2] = np.nan
    with pytest.raises(Fault, match="FR_calf_joint is sent a velocity of nan rad/s"):
        stop.tick()
    with pytest.raises(
        WorkflowError, match=r"scale is 1.5; write a number above 0 to 1, or beyond: trip"
    ):
        it.block("velocity_limits", scale=1.5)


@pytest.mark.filterwarnings("ignore:overflow encountered")
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("num_robots", [None, 3])
def test_finite_names_state_and_joint(bench, value, num_robots):
    it = bench(num_robots=num_robots)
    it.stand()
    block = it.block("finite")
    block.tick()
    it.states.joint_pos_target[..., 0] = 1e30  # its square overflows, but it is a number
    block.tick()
    it.states.joint_damping[..., 7] = value
    with pytest.raises(Fault) as error:
        block.tick()
    who = "robot 0, " if num_robots else ""
    assert str(error.value) == f"{who}joint_damping of joint RR_thigh_joint is {value}"


@pytest.mark.parametrize("num_robots", [None, 3])
def test_tilt_stop_trips_beyond_its_angle(bench, num_robots):
    it = bench(num_robots=num_robots)
    block = it.block("tilt_stop", angle=0.8)
    tilted = it.block("tilted", angle=0.8)

    def lean(angle: float) -> None:
        it.states.projected_gravity[-1 if num_robots else ...] = (0, np.sin(angle), -np.cos(angle))

    lean(0.79)
    block.tick()
    assert not tilted.tick()
    lean(0.81)
    assert tilted.tick()
    with pytest.raises(Fault) as error:
        block.tick()
    who = "robot 2: " if num_robots else ""
    assert str(error.value) == f"{who}the base leans by 0.81 rad, allowed are 0.80"
    lean(np.nan)
    assert tilted.tick()
    with pytest.raises(Fault) as error:
        block.tick()
    assert str(error.value) == f"{who}projected_gravity is NaN; is the IMU there?"


def test_velocity_stop_names_the_joint(bench):
    it = bench(num_robots=2)
    block = it.block("velocity_stop", factor=1.1)
    it.states.joint_vel[1, 2] = -1.09 * it.robot.velocity_limit[2]
    block.tick()
    it.states.joint_vel[1, 2] = -1.2 * it.robot.velocity_limit[2]
    with pytest.raises(Fault) as error:
        block.tick()
    assert str(error.value) == (
        "robot 1, joint FR_calf_joint moves at -18.84 rad/s, allowed are 17.27"
    )
    it.states.joint_vel = 0.0
    it.states.joint_vel[0, 0] = np.nan
    with pytest.raises(Fault, match="robot 0, joint FR_hip_joint moves at nan rad/s"):
        block.tick()


def test_stale_stop_waits_for_its_timeout(bench):
    it = bench()
    block = it.block("stale_stop", timeout=0.1)
    for stamp in (1, 2, 2, 2, 3, 3, 3, 3, 3):
        it.states.stamp_ns = stamp
        block.tick()
    with pytest.raises(Fault) as error:
        block.tick()
    assert str(error.value) == (
        "the robot's data is stale: stamp_ns has been 3 for 5 ticks (timeout 0.1 s); "
        "is the link up?"
    )


@pytest.mark.parametrize(
    ("block", "options", "message"),
    [
        (
            "joint_limits",
            {"margin": 1.0},
            "block 'joint_limits': margin 1.0 rad leaves joint FR_calf_joint no range; give less",
        ),
        (
            "effort_limits",
            {"scale": 0.0},
            "block 'effort_limits': scale is 0.0; write a number above 0 to 10, or null; to "
            "run without it leave it out of safety:",
        ),
        (
            "rate_limit",
            {"max_rate": "fast"},
            "block 'rate_limit': max_rate is 'fast'; write a number above 0 to 200 [rad/s] or "
            "robot; to run without it leave it out of safety:",
        ),
        (
            "tilt_stop",
            {"angle": 60},
            "block 'tilt_stop': angle is 60; write a number above 0 to 1.5708 [rad]; to run "
            "without it leave it out of safety:",
        ),
        (
            "velocity_stop",
            {"limit": -1.0},
            "block 'velocity_stop': limit is -1.0; write a number above 0 to 200 [rad/s], or "
            "null; to run without it leave it out of safety:",
        ),
    ],
)
def test_wrong_options(bench, block, options, message):
    with pytest.raises(WorkflowError) as error:
        bench().block(block, **options)
    assert str(error.value) == message


@pytest.mark.parametrize(
    ("block", "remedy"),
    [
        ("rate_limit", "give rate_limit a max_rate in [rad/s]"),
        ("velocity_stop", "give velocity_stop a limit in [rad/s]"),
    ],
)
def test_unknown_velocity_limits_are_named(bench, block, remedy):
    import dataclasses

    it = bench()
    it.robot = dataclasses.replace(it.robot, velocity_limit=np.full(12, np.nan, np.float32))
    with pytest.raises(RobotError) as error:
        it.block(block)
    assert str(error.value) == (
        f"robot go2 does not say the velocity limit of joint FR_hip_joint; {remedy}"
    )
