"""forward_command: follows no faster than told, within limits, holds without a command."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from unicon_base.errors import RobotError, UniconError, WorkflowError
from unicon_core.runtime import Runner, RunOptions
from unicon_core.states.standard import COMMAND_STATES, forwarded_states
from unicon_core.workflow import Program
from unicon_core.workflow.uses import block as use
from unicon_core.workflow.uses import of

Bench = Any
Build = Callable[..., Bench]
BEGIN = np.tile(np.array([0.1, 0.8, -1.6], np.float32), 4)


@pytest.fixture
def following(bench):
    """A Go2 that holds its targets, with the states of joint commands."""
    it = bench(states=forwarded_states(bench().robot.joint_names))
    it.states.joint_pos_target[...] = BEGIN
    it.states.joint_stiffness[...] = 1.0
    return it


def ticked(it, block, ticks=1):
    for _ in range(ticks):
        block.tick()
    return it.states.joint_pos_target.copy()


def test_without_a_command_the_targets_stay(following):
    block = following.block("forward_command")
    assert ticked(following, block, 5).tolist() == BEGIN.tolist()
    assert not following.states.joint_vel_target.any()
    assert not following.states.joint_effort_ff.any()
    assert following.states.joint_stiffness.tolist() == following.robot.joint_stiffness.tolist()


def test_a_target_moves_no_faster_than_told_and_arrives(following):
    block = following.block("forward_command", max_rate=1.0)
    following.states.joint_pos_command[0] = 0.3
    before = BEGIN
    for _ in range(60):
        after = ticked(following, block)
        assert np.abs(after - before).max() <= 1.0 * following.period * 1.001
        before = after
    assert before[0] == pytest.approx(0.3)
    assert before[1:].tolist() == BEGIN[1:].tolist()


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_positions_stay_within_the_limits_and_do_not_wind_up(following, sign):
    end = following.robot.upper if sign > 0.0 else following.robot.lower
    block = following.block("forward_command", max_rate=100.0)
    following.states.joint_pos_command[...] = sign * 1e30
    np.testing.assert_allclose(ticked(following, block, 200), end)
    following.states.joint_pos_command[...] = end - sign * 0.01
    np.testing.assert_allclose(ticked(following, block, 2), end - sign * 0.01)


def test_feed_forward_is_bounded_and_gone_with_the_command(following):
    block = following.block("forward_command", max_rate=1.5)
    states = following.states
    states.joint_vel_command[...], states.joint_effort_command[...] = 1e9, -1e9
    ticked(following, block)
    assert (states.joint_vel_target <= 1.5).all()
    np.testing.assert_allclose(states.joint_effort_ff, -following.robot.effort_limit)
    states.joint_vel_command[...] = states.joint_effort_command[...] = np.nan
    ticked(following, block)
    assert not states.joint_vel_target.any()
    assert not states.joint_effort_ff.any()


def test_it_begins_anew_where_the_targets_are(following):
    block = following.block("forward_command", max_rate=0.5)
    following.states.joint_pos_command[...] = BEGIN + 0.1
    ticked(following, block, 3)
    block.reset()
    following.states.joint_pos_command[...] = np.nan
    following.states.joint_pos_target[...] = BEGIN - 0.05
    assert ticked(following, block, 2).tolist() == (BEGIN - np.float32(0.05)).tolist()


def test_a_first_command_that_is_far_off_is_told_and_not_followed(following, capsys):
    block = following.block("forward_command", start_tolerance=0.2, max_rate=10.0)
    command = following.states.joint_pos_command
    following.states.joint_vel_command[...] = 1.0
    command[...] = BEGIN
    command[1] -= 0.6
    assert ticked(following, block, 5).tolist() == BEGIN.tolist()
    assert not following.states.joint_vel_target.any()
    assert capsys.readouterr().out == (
        "forward_command: the first command is 0.60 rad from the target of FR_thigh_joint, allowed "
        "are 0.2 (start_tolerance); the joints hold until it is nearer\n"
    )
    command[1] = BEGIN[1] - 0.1  # near enough
    ticked(following, block, 20)
    command[1] = BEGIN[1] - 0.7  # what is followed may go far
    assert ticked(following, block, 40)[1] == pytest.approx(BEGIN[1] - 0.7)
    command[...] = np.nan
    ticked(following, block)
    command[...] = BEGIN  # after silence it is a first one again
    assert ticked(following, block, 5)[1] == pytest.approx(BEGIN[1] - 0.7)
    assert capsys.readouterr().out.count("\n") == 1


def test_an_integral_takes_off_what_gravity_leaves_and_not_more(following):
    block = following.block("forward_command", integral=2.0)
    following.states.joint_pos[...] = BEGIN - 0.05  # hangs below what it is sent to
    before = ticked(following, block, 1)
    after = ticked(following, block, 10)
    np.testing.assert_allclose(after - before, 10 * 2.0 * following.period * 0.05, rtol=1e-2)
    np.testing.assert_allclose(ticked(following, block, 500), BEGIN + 0.25, rtol=1e-6)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"max_rate": 0}, "max_rate is 0; write a number above 0 to 200 [rad/s]"),
        ({"max_rate": float("inf")}, "max_rate is inf"),
        ({"max_rate": "fast"}, "max_rate is 'fast'; write a number above 0 to 200"),
        ({"start_tolerance": -1}, "start_tolerance is -1"),
        ({"integral": 1e9}, "integral is"),
        ({"stiffness_scale": 9}, "stiffness_scale is 9"),
    ],
)
def test_an_option_that_is_no_bound_is_refused(following, options, message):
    with pytest.raises(WorkflowError) as caught:
        following.block("forward_command", **options)
    assert message in str(caught.value)


def test_max_rate_robot_takes_the_robots_velocity_limits(following):
    block = following.block("forward_command", max_rate="robot")
    np.testing.assert_array_equal(block.tick.max_rate, following.robot.velocity_limit)


def test_it_moves_the_joints_that_are_named_and_leaves_others_alone(following):
    """They may stand anywhere: the Go2's front legs are joints 0 to 5, its knees every third."""
    states = following.states
    for moves, own in ((["F*"], range(6)), (["*_calf_joint"], (2, 5, 8, 11))):
        others = np.setdiff1d(np.arange(12), own)
        for name in COMMAND_STATES:
            states[name][...] = 7.0
        states.joint_pos_target[...] = BEGIN
        states.joint_pos_command[...] = BEGIN + np.float32(0.01)
        states.joint_vel_command[...] = states.joint_effort_command[...] = 0.5
        block = following.block("forward_command", moves=moves, integral=1.0)
        ticked(following, block, 5)
        assert (states.joint_pos_target[others] == BEGIN[others]).all()
        assert (states.joint_pos_target[list(own)] != BEGIN[list(own)]).all()
        for name in COMMAND_STATES[1:]:
            assert (states[name][others] == 7.0).all()
            assert (states[name][list(own)] != 7.0).all()
        assert block.tick.moves == tuple(moves)


def test_all_joints_by_name_are_all_joints(following):
    rng = np.random.default_rng(4)
    made = [following.block("forward_command", **more) for more in ({}, {"moves": ["*"]})]
    for _ in range(20):
        for name in ("joint_pos_command", "joint_vel_command", "joint_effort_command"):
            said = rng.uniform(-2.0, 2.0, 12)
            following.states[name] = np.where(rng.uniform(size=12) < 0.3, np.nan, said)
        before = following.states.snapshot()
        after = []
        for block in made:
            following.states.restore(before)
            block.tick()
            after.append([following.states[name].copy() for name in COMMAND_STATES])
        np.testing.assert_array_equal(*after)


def test_in_silence_it_goes_home_slowly_and_comes_back_without_a_jump(following):
    states = following.states
    home = following.robot.default_joint_pos
    block = following.block("forward_command", max_rate=5.0, silent="home", home_rate=0.5)
    states.joint_pos_command[...] = BEGIN + 0.4
    away = ticked(following, block, 50)
    np.testing.assert_allclose(away, BEGIN + 0.4, atol=1e-6)
    states.joint_pos_command[...] = np.nan
    before = away
    most = 0.5 * following.period * 1.001
    for _ in range(20):
        now = ticked(following, block)
        assert (np.abs(now - home) <= np.abs(before - home)).all()
        assert np.abs(now - before).max() <= most
        before = now
    assert np.abs(before - away).max() == pytest.approx(20 * 0.5 * following.period, rel=1e-3)
    states.joint_pos_command[...] = BEGIN + 0.4
    now = ticked(following, block)
    assert np.abs(now - before).max() <= 5.0 * following.period * 1.001
    np.testing.assert_allclose(ticked(following, block, 50), BEGIN + 0.4, atol=1e-6)
    states.joint_pos_command[...] = np.nan
    np.testing.assert_allclose(ticked(following, block, 500), home, atol=1e-6)
    assert not states.joint_vel_target.any()


def test_home_may_be_another_pose(following):
    states = following.states
    robot = following.robot
    block = following.block("forward_command", silent="home", home={"*_hip_joint": 0.2})
    states.joint_pos_command[...] = np.nan
    wanted = [
        0.2 if "hip" in name else x for name, x in zip(robot.joint_names, robot.default_joint_pos)
    ]
    np.testing.assert_allclose(ticked(following, block, 500), wanted, atol=1e-6)
    block = following.block("forward_command", silent="home", home="rest")
    np.testing.assert_allclose(ticked(following, block, 500), robot.rest_joint_pos, atol=1e-6)


def test_one_joint_or_torque_that_is_commanded_is_no_silence(following):
    states = following.states
    block = following.block("forward_command", silent="home")
    states.joint_pos_command[3] = BEGIN[3] + 0.1
    after = ticked(following, block, 20)
    assert np.delete(after, 3).tolist() == np.delete(BEGIN, 3).tolist()
    states.joint_pos_command[3] = np.nan
    states.joint_effort_command[7] = 1.0
    assert ticked(following, block, 20).tolist() == after.tolist()
    states.joint_effort_command[7] = np.nan
    assert (ticked(following, block, 20) != after).any()


def test_others_that_are_commanded_do_not_keep_it_from_home(following):
    block = following.block("forward_command", moves=["F*"], silent="home")
    following.states.joint_pos_command[6:] = 0.3
    after = ticked(following, block, 200)
    np.testing.assert_allclose(after[:6], following.robot.default_joint_pos[:6], atol=1e-6)
    assert after[6:].tolist() == BEGIN[6:].tolist()


def test_each_robot_of_a_batch_goes_home_by_itself(bench):
    it = bench(num_robots=2, states=forwarded_states(bench().robot.joint_names))
    it.states.joint_pos_target[...] = BEGIN
    it.states.joint_stiffness[...] = 1.0
    it.states.joint_pos_command[1, 4] = BEGIN[4]
    block = it.block("forward_command", silent="home")
    ticked(it, block, 200)
    np.testing.assert_allclose(it.states.joint_pos_target[0], it.robot.default_joint_pos, atol=1e-6)
    assert it.states.joint_pos_target[1].tolist() == BEGIN.tolist()


def test_a_first_command_after_home_may_be_refused_and_holds(following, capsys):
    block = following.block("forward_command", silent="home", start_tolerance=0.2)
    home = ticked(following, block, 300)
    following.states.joint_pos_command[...] = home
    following.states.joint_pos_command[2] -= 0.5
    assert ticked(following, block, 5).tolist() == home.tolist()
    assert "the target of FR_calf_joint" in capsys.readouterr().out


def test_gains_may_be_given_in_place_of_the_robots(following):
    robot = following.robot
    states = following.states
    block = following.block(
        "forward_command", stiffness={"*_hip_joint": 33.0}, damping=4.0, stiffness_scale=0.5
    )
    ticked(following, block)
    hips = robot.group(["*_hip_joint"])
    assert (states.joint_stiffness[hips] == 33.0).all()
    others = np.setdiff1d(np.arange(12), hips)
    np.testing.assert_allclose(states.joint_stiffness[others], 0.5 * robot.joint_stiffness[others])
    assert (states.joint_damping == 4.0).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"moves": ["wings"]}, "no group or joint 'wings'"),
        ({"silent": "sleep"}, "silent 'sleep' is not known; known: hold, home"),
        ({"silent": "home", "home": "bed"}, "no pose 'bed'; "),
        ({"silent": "home", "home": {"*_hip_joint": 3.0}}, "is beyond the limits of joint"),
        ({"silent": "home", "home_rate": 0}, "home_rate is 0; write a number above 0"),
        ({"stiffness": -1}, "stiffness is -1; write a number from 0 to 2000 [N·m/rad]"),
        ({"damping": {"*_hip_joint": 1e9}}, "damping.*_hip_joint is 1000000000.0"),
        ({"stiffness": {"elbow": 1.0}}, "no group or joint 'elbow'"),
    ],
)
def test_a_wrong_joint_home_or_gain_is_told(following, options, message):
    with pytest.raises(UniconError) as told:
        following.block("forward_command", **options)
    assert message in str(told.value)


def test_a_home_that_the_robot_file_lacks_is_told(bench):
    robot = bench().robot
    pose = robot.default_joint_pos.copy()
    pose[4] = np.nan
    it = bench(replace(robot, default_joint_pos=pose), states=forwarded_states(robot.joint_names))
    with pytest.raises(RobotError, match="does not say the default pose of joint FL_thigh_joint"):
        it.block("forward_command", silent="home")
    it.block("forward_command", silent="home", moves=["FR*"])


def test_members_have_slices_of_the_wholes_commands():
    hands = {f"{side}_hand": f"inspire_rh56_{side}" for side in ("left", "right")}
    program = Program(
        robot={"body": "g1_29dof", **hands},
        platform="fake",
        rate=50,
        flow={
            "zip": [
                of(member, use("forward_command", silent="home"))
                for member in ("body", "left_hand", "right_hand")
            ]
        },
    )
    commanded = program.states["joint_pos_command"]
    assert commanded.shape == (program.robot.num_joints,)
    right = program.robot.joints_of("right_hand")
    commanded[right] = 0.2
    Runner(program, RunOptions(duration=1.0, speed="max", warn=lambda _: None)).run()
    target = program.states["joint_pos_target"]
    np.testing.assert_allclose(target[right], 0.2, atol=1e-6)
    left = program.robot.joints_of("left_hand")
    home = program.robot.members["left_hand"].default_joint_pos
    np.testing.assert_allclose(target[left], home, atol=1e-6)
