"""forward_command: follows no faster than told, within limits, holds without a command."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from unicon_core.errors import WorkflowError
from unicon_core.states.standard import forwarded_states

Bench = Any
Build = Callable[..., Bench]
BEGIN = np.tile(np.array([0.1, 0.8, -1.6], np.float32), 4)


@pytest.fixture
def following(bench: Build) -> Bench:
    """A Go2 that holds its targets, with the states of joint commands."""
    it = bench(states=forwarded_states(bench().robot.joint_names))
    it.states.joint_pos_target[...] = BEGIN
    it.states.joint_stiffness[...] = 1.0
    return it


def ticked(it: Bench, block: Any, ticks: int = 1) -> Any:
    for _ in range(ticks):
        block.tick()
    return it.states.joint_pos_target.copy()


def test_without_a_command_the_targets_stay(following: Bench) -> None:
    block = following.block("forward_command")
    assert ticked(following, block, 5).tolist() == BEGIN.tolist()
    assert not following.states.joint_vel_target.any()
    assert not following.states.joint_effort_ff.any()
    assert following.states.joint_stiffness.tolist() == following.robot.joint_stiffness.tolist()


def test_a_target_moves_no_faster_than_told_and_arrives(following: Bench) -> None:
    block = following.block("forward_command", max_rate=1.0)
    following.states.joint_pos_command[0] = 0.3
    before = BEGIN
    for _ in range(60):
        after = ticked(following, block)
        assert np.abs(after - before).max() <= 1.0 * following.period * 1.001
        before = after
    assert before[0] == pytest.approx(0.3)
    assert before[1:].tolist() == BEGIN[1:].tolist()


def test_positions_stay_within_the_limits_and_do_not_wind_up(following: Bench) -> None:
    block = following.block("forward_command", max_rate=100.0)
    following.states.joint_pos_command[...] = 1e30
    np.testing.assert_allclose(ticked(following, block, 200), following.robot.upper)
    following.states.joint_pos_command[...] = following.robot.upper - 0.01
    np.testing.assert_allclose(ticked(following, block, 2), following.robot.upper - 0.01)


def test_feed_forward_is_bounded_and_gone_with_the_command(following: Bench) -> None:
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


def test_it_begins_anew_where_the_targets_are(following: Bench) -> None:
    block = following.block("forward_command", max_rate=0.5)
    following.states.joint_pos_command[...] = BEGIN + 0.1
    ticked(following, block, 3)
    block.reset()
    following.states.joint_pos_command[...] = np.nan
    following.states.joint_pos_target[...] = BEGIN - 0.05
    assert ticked(following, block, 2).tolist() == (BEGIN - np.float32(0.05)).tolist()


def test_a_first_command_that_is_far_off_is_told_and_not_followed(
    following: Bench, capsys: pytest.CaptureFixture[str]
) -> None:
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


def test_an_integral_takes_off_what_gravity_leaves_and_not_more(following: Bench) -> None:
    block = following.block("forward_command", integral=2.0)
    following.states.joint_pos[...] = BEGIN - 0.05  # hangs below what it is sent to
    before = ticked(following, block, 1)
    after = ticked(following, block, 10)
    np.testing.assert_allclose(after - before, 10 * 2.0 * following.period * 0.05, rtol=1e-2)
    np.testing.assert_allclose(ticked(following, block, 500), BEGIN + 0.25, rtol=1e-6)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"max_rate": 0}, "max_rate is 0; give a number above 0 to 200 [rad/s]"),
        ({"max_rate": float("inf")}, "max_rate is inf"),
        ({"max_rate": "fast"}, "max_rate is 'fast'; give [rad/s] above 0, or robot"),
        ({"start_tolerance": -1}, "start_tolerance is -1"),
        ({"integral": 1e9}, "integral is"),
        ({"stiffness_scale": 9}, "stiffness_scale is 9"),
    ],
)
def test_an_option_that_is_no_bound_is_refused(
    following: Bench, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(WorkflowError) as caught:
        following.block("forward_command", **options)
    assert message in str(caught.value)


def test_max_rate_robot_takes_the_robots_velocity_limits(following: Bench) -> None:
    block = following.block("forward_command", max_rate="robot")
    np.testing.assert_array_equal(block.tick.max_rate, following.robot.velocity_limit)
