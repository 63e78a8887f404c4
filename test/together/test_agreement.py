"""Agreement of robots on a moment, in made-up time: words take time, ticks stall, robots die."""

from __future__ import annotations

import random
from dataclasses import dataclass, field

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from unicon_core.synchronised_start.agreement import FRESH_NS, LEAD_NS, Agreement, Word
from unicon_core.synchronised_start.meeting import BEGUN, READY

MS = 1_000_000
TIMEOUT = 3_000 * MS


@dataclass
class Robot:
    """One side, ticked at its own rate."""

    name: str
    side: Agreement
    period: int
    ready_at: int
    next_at: int
    dies_at: int = 1 << 62
    stall: tuple[int, int] = (0, 0)
    said: list[tuple[int, Word]] = field(default_factory=list)
    faulted: bool = False


def made(names: str, dice: random.Random, alone: bool) -> list[Robot]:
    robots = []
    for name in names:
        period = dice.choice((10, 20, 50)) * MS
        side = Agreement(tuple(names), name, TIMEOUT, alone)
        ready = dice.randrange(1_000) * MS
        robots.append(Robot(name, side, period, ready, dice.randrange(period)))
    return robots


def simulated(robots: list[Robot], dice: random.Random, latency_ms: int) -> None:
    """Tick all of them, at most for ten seconds."""
    on_the_way = {name.name: dice.randrange(1, latency_ms + 1) * MS for name in robots}
    while True:
        robot = min(robots, key=lambda each: each.next_at)
        now = robot.next_at
        moments = [each.side.moment_ns for each in robots if now < each.dies_at]
        if now > 10_000 * MS or (all(moments) and now > max(moments)):
            return
        robot.next_at += robot.period + dice.randrange(MS)
        if robot.stall[0] <= now < robot.stall[1]:
            robot.next_at = robot.stall[1]
            continue
        begun = robot.side.moment_ns and robot.side.moment_ns - now <= 2.0 * robot.period
        if now >= robot.dies_at or robot.faulted or begun:
            if begun and robot.said[-1][1].stage != BEGUN and now < robot.dies_at:
                robot.said.append((now, Word(BEGUN, False, robot.side.moment_ns)))
            continue
        robot.side(now, now >= robot.ready_at, heard(robot, robots, now, on_the_way))
        robot.said.append((now, robot.side.mine))
        robot.faulted = robot.side.expired and bool(robot.side.lacking) and not robot.side._alone


def heard(robot: Robot, robots: list[Robot], now: int, on_the_way: dict[str, int]) -> dict:
    words = {}
    for other in robots:
        arrived = (w for w in reversed(other.said) if w[0] + on_the_way[other.name] <= now)
        sent, word = next(arrived, (0, Word()))
        lives = now < other.dies_at and not other.faulted
        if (
            other is not robot
            and sent
            and (now - sent <= FRESH_NS or (word.stage == BEGUN and lives))
        ):
            words[other.name] = word
    return words


@settings(max_examples=25)
@given(st.integers(0, 1 << 32), st.sampled_from(("ab", "abc", "abcd")), st.booleans())
def test_all_begin_at_one_moment_a_second_behind_the_last_that_is_ready(seed, names, alone):
    dice = random.Random(seed)
    robots = made(names, dice, alone)
    simulated(robots, dice, 30)
    moments = {robot.side.moment_ns for robot in robots}
    assert len(moments) == 1
    last = max(robot.ready_at for robot in robots)
    assert 0 <= moments.pop() - last - LEAD_NS < 200 * MS
    for robot in robots:
        assert robot.side.among == tuple(names)
        assert not robot.side.late
        assert not robot.side.lacking


@settings(max_examples=25)
@given(st.integers(0, 1 << 32), st.sampled_from(("ab", "abc")), st.booleans())
def test_who_stalls_misses_the_moment_and_nobody_begins_at_another(seed, names, alone):
    dice = random.Random(seed)
    robots = made(names, dice, alone)
    begins = dice.randrange(2_500) * MS
    dice.choice(robots).stall = (begins, begins + dice.randrange(1, 800) * MS)
    simulated(robots, dice, 30)
    on_time = {robot.side.moment_ns for robot in robots if robot.side.moment_ns}
    if not alone:
        assert len(on_time) <= 1
    else:  # whoever was left goes later, by himself
        assert len(on_time) in (1, 2)
        assert all(robot.side.moment_ns for robot in robots)


@settings(max_examples=25)
@given(st.integers(0, 1 << 32), st.sampled_from(("ab", "abc")), st.booleans())
def test_who_dies_is_waited_for_and_then_a_fault_or_left_behind(seed, names, alone):
    dice = random.Random(seed)
    robots = made(names, dice, alone)
    dead = dice.choice(robots)
    dead.dies_at = dead.ready_at - 100 * MS  # it never is ready
    simulated(robots, dice, 30)
    left = [robot for robot in robots if robot is not dead]
    if not alone:
        assert not any(robot.side.moment_ns for robot in left)
        assert all(robot.faulted and dead.name in robot.side.lacking for robot in left)
        return
    assert len({robot.side.moment_ns for robot in left}) == 1
    assert left[0].side.moment_ns
    assert all(robot.side.among == tuple(r.name for r in left) for robot in left)


@pytest.mark.parametrize("before", [900, 700, 550])
def test_a_moment_is_taken_back_where_somebody_dies_before_it_is_decided(before: int) -> None:
    a = Agreement("ab", "a", TIMEOUT, False)
    a(0, True, {"b": Word(READY)})
    moment = a.mine.moment_ns
    assert moment == LEAD_NS
    a(moment - before * MS, True, {})
    assert a.mine.moment_ns == 0
    assert a.lacking == ("b",)
    a(moment - 500 * MS, True, {"b": Word(READY, False, moment)})
    assert a.moment_ns == 0  # another one is named
    assert a.mine.moment_ns == moment - 500 * MS + LEAD_NS


@pytest.mark.parametrize("moment", [-1, 1, 100 * MS, 1 << 62, -(1 << 62)])
def test_moments_from_nowhere_are_not_taken(moment: int) -> None:
    b = Agreement("ab", "b", TIMEOUT, False)
    for now in range(0, 2_000 * MS, 20 * MS):
        b(now + 1, True, {"a": Word(READY, False, moment)})
        b(now + 2, True, {"a": Word(77, True, moment)})
    assert b.moment_ns == b.mine.moment_ns == 0
