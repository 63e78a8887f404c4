"""Player: what is commanded tick by tick, when it is over, and what takes it away."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from unicon_core.trajectory.accepted import Code, Limits, Points, Refusal
from unicon_core.trajectory.player import Ending, Player, Tolerances

JOINTS = ("hip", "knee")
LIMITS = Limits(JOINTS, np.full(2, -2.0), np.full(2, 2.0), np.full(2, 5.0))
PERIOD = 0.1
WAY = Points(JOINTS, [0.5, 1.0], [[0.5, 0.0], [0.5, -0.5]], [[], []], [[], []])
INFINITE = np.full(2, np.inf)


class Robot:
    """Follows commands at once, as a `forward_command` without bounds."""

    def __init__(self) -> None:
        self.position, self.velocity = np.full(2, np.nan), np.full(2, np.nan)
        self.held, self.measured = np.zeros(2), np.zeros(2)
        self.ticks, self.follows, self.off = 0, True, 0.0
        self.endings: list[Ending] = []
        self.player = Player(
            LIMITS,
            PERIOD,
            self.position,
            self.velocity,
            lambda: self.held,
            self.measured,
            lambda: self.ticks,
        )
        self.tick(2)

    def tick(self, count: int = 1) -> None:
        for _ in range(count):
            self.player()
            if not self.follows:
                self.ticks = 0
                continue
            self.ticks += 1
            np.copyto(self.held, self.position, where=~np.isnan(self.position))
            self.measured[...] = self.held + self.off

    def play(self, tolerances: Tolerances | None = None, **changed: Any) -> None:
        self.player.play(replace(WAY, **changed), tolerances, self.endings.append)


def test_points_are_there_at_their_times_and_it_rests_at_the_last() -> None:
    robot = Robot()
    robot.play()
    robot.tick(5)
    np.testing.assert_allclose(robot.position, [0.5, 0.0])
    robot.tick(4)
    np.testing.assert_allclose(robot.velocity, [0.0, -1.0])
    assert not robot.endings
    robot.tick(2)
    assert robot.endings == [Ending(Code.SUCCESSFUL)]
    robot.tick(20)
    np.testing.assert_allclose(robot.position, [0.5, -0.5])
    assert not robot.velocity.any()
    assert len(robot.endings) == 1


def test_a_cancel_says_nothing_any_more_from_the_same_tick_on() -> None:
    robot = Robot()
    robot.play()
    robot.tick(3)
    robot.player.cancel()
    there = robot.held.copy()
    robot.tick(5)
    assert np.isnan(robot.position).all()
    assert np.isnan(robot.velocity).all()
    assert robot.held.tolist() == there.tolist()
    assert robot.endings == [Ending(Code.SUCCESSFUL, "canceled", canceled=True)]


def test_a_new_one_begins_where_the_old_one_is_with_its_speed() -> None:
    robot = Robot()
    robot.play()
    robot.tick(3)
    robot.play(times=[1.0, 2.0], velocities=[[0.0, 0.0]] * 2)
    assert [e.reason for e in robot.endings] == ["another trajectory came in its place"]
    before = robot.position.copy()
    robot.tick()
    np.testing.assert_allclose(robot.position - before, [0.1, 0.0], atol=0.02)  # 1 rad/s on


def test_a_refused_one_leaves_the_other_on_its_way() -> None:
    robot = Robot()
    robot.play()
    robot.tick(2)
    with pytest.raises(Refusal):
        robot.play(joints=("hip", "wheel"))
    robot.tick(20)
    assert robot.endings == [Ending(Code.SUCCESSFUL)]


def test_nobody_who_follows_is_a_refusal() -> None:
    robot = Robot()
    robot.follows = False
    robot.tick(2)
    with pytest.raises(Refusal, match="the flow does not follow joint commands now"):
        robot.play()
    assert np.isnan(robot.position).all()


@pytest.mark.parametrize("again", [False, True])
def test_a_flow_that_goes_on_or_begins_anew_takes_it_away(again: bool) -> None:
    robot = Robot()
    robot.play()
    robot.tick(3)
    if again:  # as after ~/reset: the block runs again, as one that was just entered
        robot.ticks = 1
    else:
        robot.follows = False
        robot.tick()
    robot.tick()
    assert np.isnan(robot.position).all()
    assert [e.code for e in robot.endings] == [Code.INVALID_GOAL]


def test_a_path_tolerance_ends_it_and_the_joints_hold() -> None:
    robot = Robot()
    robot.play(Tolerances(np.array([0.05, np.inf]), INFINITE))
    robot.tick(3)
    robot.off = 0.1
    robot.tick(2)
    (ending,) = robot.endings
    assert ending.code is Code.PATH_TOLERANCE_VIOLATED
    assert ending.reason == "hip was 0.100 rad from its path after 0.4 s; allowed are 0.05"
    assert np.isnan(robot.position).all()


def test_a_goal_is_waited_for_within_its_time() -> None:
    robot = Robot()
    robot.play(Tolerances(INFINITE, np.full(2, 0.05), 0.5))
    robot.off = 0.1
    robot.tick(13)
    assert not robot.endings
    robot.off = 0.01
    robot.tick(2)
    assert robot.endings == [Ending(Code.SUCCESSFUL)]
    robot.play(Tolerances(INFINITE, np.full(2, 0.05), 0.3))
    robot.off = 0.1
    robot.tick(16)
    assert robot.endings[1].code is Code.GOAL_TOLERANCE_VIOLATED


def test_a_goal_without_a_time_is_waited_for_without_an_end() -> None:
    robot = Robot()
    robot.play(Tolerances(INFINITE, np.full(2, 0.05)))
    robot.off = 0.1
    robot.tick(200)
    assert not robot.endings
    robot.off = 0.0
    robot.tick(2)
    assert robot.endings == [Ending(Code.SUCCESSFUL)]
