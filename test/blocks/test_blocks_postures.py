"""pose, hold, damp, sway: what they command, tick by tick."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from unicon_base.errors import RobotError, WorkflowError

Bench = Any
Build = Callable[..., Bench]


def test_pose_begins_at_the_measured_position_of_limp_joints(bench):
    it = bench()
    it.states.joint_pos = it.robot.rest_joint_pos
    it.states.joint_pos_target = 99.0
    pose = it.block("pose", to="stand", duration=2.0)
    pose.tick()
    way = it.robot.default_joint_pos - it.robot.rest_joint_pos
    share = 0.5 - 0.5 * np.cos(np.pi / 100)
    expected = it.robot.rest_joint_pos + share * way
    np.testing.assert_allclose(it.states.joint_pos_target, expected, atol=1e-6)


def test_pose_begins_at_the_target_of_stiff_joints(bench):
    """A sagging joint must not get a jump of its torque."""
    it = bench()
    it.stand()
    it.states.joint_pos = it.robot.default_joint_pos - 0.2
    it.block("pose", to="stand", duration=2.0).tick()
    np.testing.assert_allclose(it.states.joint_pos_target, it.robot.default_joint_pos, atol=1e-6)


def test_pose_is_smooth_and_ends_exactly_in_its_time(bench):
    it = bench()
    it.states.joint_pos = it.robot.rest_joint_pos
    pose = it.block("pose", to="stand", duration=1.0)
    path = []
    while not pose.tick():
        path.append(it.states.joint_pos_target.copy())
    assert len(path) == 49
    assert it.states.joint_pos_target.tolist() == it.robot.default_joint_pos.tolist()
    speed = np.abs(np.diff([it.robot.rest_joint_pos, *path, it.robot.default_joint_pos], axis=0))
    distance = np.abs(it.robot.default_joint_pos - it.robot.rest_joint_pos)
    assert (speed.max(axis=0) <= np.pi / 2 * distance / 50 + 1e-6).all()
    assert (speed[0] < 0.1 * speed.max(axis=0) + 1e-6).all()
    assert not it.states.joint_vel_target.any()
    assert not it.states.joint_effort_ff.any()
    assert it.states.joint_stiffness.tolist() == it.robot.joint_stiffness.tolist()


def test_pose_can_run_again_after_it_was_done(bench):
    it = bench()
    it.stand()
    lie = it.block("pose", to="rest", duration=0.5)
    stand = it.block("pose", to="stand", duration=0.5)
    for _ in range(2):
        assert it.ticks(lie) == 25
        assert it.states.joint_pos_target.tolist() == it.robot.rest_joint_pos.tolist()
        assert it.ticks(stand) == 25
        assert it.states.joint_pos_target.tolist() == it.robot.default_joint_pos.tolist()


def test_pose_by_pattern_leaves_other_joints(bench):
    it = bench()
    it.stand()
    it.ticks(it.block("pose", to={"*_calf_joint": -1.2, "FR_hip_joint": 0.3}, duration=0.1))
    expected = it.robot.default_joint_pos.copy()
    expected[2::3], expected[0] = -1.2, 0.3
    np.testing.assert_allclose(it.states.joint_pos_target, expected, rtol=1e-6)


def test_pose_fades_the_gains_in(bench):
    it = bench()
    pose = it.block("pose", duration=2.0, fade_in=1.0, stiffness_scale=0.5, damping_scale=2.0)
    stiffness = []
    while not pose.tick():
        stiffness.append(float(it.states.joint_stiffness[0]))
    np.testing.assert_allclose(stiffness[:50], 30.0 * np.arange(1, 51) / 50, rtol=1e-5)
    np.testing.assert_allclose(stiffness[50:], 30.0)
    assert it.states.joint_damping[0] == 2 * it.robot.joint_damping[0]


def test_hold_keeps_the_target_of_its_entry(bench):
    it = bench()
    it.stand()
    hold = it.block("hold", duration=0.1)
    for _ in range(4):
        assert not hold.tick()
        it.states.joint_pos_target += 1.0  # as a safety block might
    assert hold.tick()
    np.testing.assert_allclose(it.states.joint_pos_target, it.robot.default_joint_pos, rtol=1e-6)


def test_hold_may_keep_the_gains_of_a_policy(bench):
    it = bench()
    it.stand()
    it.states.joint_stiffness = 7.0
    it.block("hold", keep_gains=True).tick()
    assert set(it.states.joint_stiffness.tolist()) == {7.0}
    it.block("hold").tick()
    assert it.states.joint_stiffness.tolist() == it.robot.joint_stiffness.tolist()


def test_damp_lets_go_with_damping(bench):
    it = bench()
    it.stand()
    it.states.joint_effort_ff = 3.0
    it.states.joint_vel_target = 1.0
    it.states.joint_pos = 0.3
    assert it.ticks(it.block("damp", duration=0.1)) == 5
    assert not it.states.joint_stiffness.any()
    assert not it.states.joint_effort_ff.any()
    assert not it.states.joint_vel_target.any()
    assert it.states.joint_damping.tolist() == it.robot.joint_damping.tolist()
    assert it.states.joint_pos_target.tolist() == it.states.joint_pos.tolist()
    it.block("damp", damping=1.5).tick()
    assert set(it.states.joint_damping.tolist()) == {1.5}


GAINS = {
    "*_thigh_joint": [0.6, 0, 0],
    "*_hip_joint": [0, -0.6, 0],
    "F?_hip_joint": [0, 0, -0.3],
    "R?_hip_joint": [0, 0, 0.3],
}


def test_sway_moves_targets_with_the_command(bench):
    it = bench()
    it.stand()
    it.states.velocity_command = (0.5, 0.2, -1.0)
    sway = it.block("sway", gains=GAINS, time_constant=0.0)
    sway.tick()
    offset = it.states.joint_pos_target - it.robot.default_joint_pos
    np.testing.assert_allclose(offset[1::3], 0.3, atol=1e-6)
    np.testing.assert_allclose(offset[[0, 3]], -0.12 + 0.3, atol=1e-6)
    np.testing.assert_allclose(offset[[6, 9]], -0.12 - 0.3, atol=1e-6)
    np.testing.assert_allclose(offset[2::3], 0.0, atol=1e-6)


def test_sway_is_filtered_and_stays_within_the_limits(bench):
    it = bench()
    it.stand()
    it.states.velocity_command = (100.0, 100.0, 0.0)
    sway = it.block("sway", gains=GAINS, time_constant=0.2, duration=3.0)
    sway.tick()
    first = np.abs(it.states.joint_pos_target - it.robot.default_joint_pos).max()
    assert 0 < first < 0.5
    it.ticks(sway)
    assert (it.states.joint_pos_target <= it.robot.upper + 1e-6).all()
    np.testing.assert_allclose(it.states.joint_pos_target[1::3], it.robot.upper[1::3], rtol=1e-3)


def test_sway_oscillates_by_itself(bench):
    it = bench()
    it.stand()
    sway = it.block(
        "sway", gains=GAINS, amplitude=[0.2, 0, 0], frequency=0.5, time_constant=0.0, duration=2.0
    )
    trace = []
    done = False
    while not done:
        done = bool(sway.tick())
        trace.append(float(it.states.joint_pos_target[1] - it.robot.default_joint_pos[1]))
    ticks = np.arange(1, 101)
    np.testing.assert_allclose(trace, 0.12 * np.sin(np.pi * 0.02 * ticks), atol=1e-5)


@pytest.mark.parametrize(
    ("block", "options", "message"),
    [
        (
            "pose",
            {"to": "stnd"},
            "block 'pose': no pose 'stnd'; did you mean 'stand'? "
            "known: default, lie, rest, stand; or joints to [rad]",
        ),
        (
            "pose",
            {"to": {"*_knee_joint": 1.0}},
            "block 'pose': robot go2 has no joint like '*_knee_joint'; known: FL_calf_joint, ",
        ),
        (
            "pose",
            {"to": {"FR_calf_joint": 0.5}},
            "block 'pose': 0.5 rad is beyond the limits of joint FR_calf_joint: "
            "-2.7227 to -0.83776 rad; correct the pose",
        ),
        (
            "pose",
            {"duration": -1},
            "block 'pose': duration is -1; write a number from 0.1 to 1e+07 [s]",
        ),
        (
            "damp",
            {"damping": -1.0},
            "block 'damp': damping is -1.0; write a number from 0 to 200 [N·m·s/rad], or null",
        ),
        (
            "sway",
            {"gains": {"*_hip_joint": [1.0]}},
            "block 'sway': gains.*_hip_joint is [1.0]; write [per vx, per vy, per wz]",
        ),
        (
            "sway",
            {"gains": GAINS, "amplitude": [1.0]},
            "block 'sway': amplitude is [1.0]; write [vx, vy, wz]",
        ),
    ],
)
def test_wrong_options(bench, block, options, message):
    with pytest.raises(WorkflowError) as error:
        bench().block(block, **options)
    assert str(error.value).startswith(message)


def test_the_gains_of_another_robot_are_told_what_any_robot_does(bench):
    with pytest.raises(WorkflowError, match=r"no joint like '\*_knee'.*, or run h1_stand, which"):
        bench().block("sway", gains={"*_knee": [0.1, 0.0, 0.0]})


def test_unknown_pose_and_gains_are_named(bench):
    import dataclasses

    it = bench()
    unknown = it.robot.rest_joint_pos.copy()
    unknown[4] = np.nan
    it.robot = dataclasses.replace(it.robot, rest_joint_pos=unknown)
    with pytest.raises(RobotError) as error:
        it.block("pose", to="rest")
    assert str(error.value) == (
        "block 'pose': robot go2 does not say `rest` (the rest pose) of FL_thigh_joint; "
        f"give it in {it.robot.path}, or give joints and positions"
    )
    it.robot = dataclasses.replace(it.robot, default_joint_pos=np.full_like(unknown, np.nan))
    with pytest.raises(
        RobotError, match=r"say `default` \(the stand pose\) of FR_hip_joint and 11"
    ):
        it.block("pose", to="stand")
    it.robot = dataclasses.replace(it.robot, joint_damping=unknown)
    with pytest.raises(RobotError) as error:
        it.block("hold")
    assert str(error.value) == (
        "block 'hold': robot go2 does not say the damping of joint FL_thigh_joint (1 joints); "
        f"give it in {it.robot.path}"
    )
