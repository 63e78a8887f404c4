"""What is refused of trajectories, each beside its code and line, and what begins where."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from unicon_core.trajectory.accepted import Code, Limits, Points, Refusal, Start, accepted

JOINTS = ("hip", "knee")
LIMITS = Limits(JOINTS, np.array([-1.0, -2.0]), np.array([1.0, 0.0]), np.array([2.0, 3.0]))
START = Start(np.array([0.0, -1.0]), np.zeros(2), np.array([0.02, -1.05]))
GOOD = Points(JOINTS, [1.0, 2.0], [[0.5, -1.0], [0.0, -1.5]], [[], []], [[], []])


def refusal(limits: Limits = LIMITS, start: Start = START, **changed: Any) -> tuple[Code, str]:
    with pytest.raises(Refusal) as caught:
        accepted(replace(GOOD, **changed), limits, start)
    assert "\n" not in caught.value.reason
    return caught.value.code, caught.value.reason


def test_a_good_one_begins_at_the_present_target_and_passes_its_points() -> None:
    path = accepted(GOOD, LIMITS, START)
    position, velocity = np.zeros(2), np.zeros(2)
    for time, wanted in ((0.0, [0, -1]), (1.0, [0.5, -1]), (2.0, [0, -1.5])):
        path.sample(time, position, velocity)
        np.testing.assert_allclose(position, wanted, atol=1e-12)


NAN = float("nan")
WRONG: list[tuple[dict[str, Any], Code, str]] = [
    ({"joints": []}, Code.INVALID_JOINTS, "the trajectory names no joints"),
    (
        {"joints": ["hip", "kne"]},
        Code.INVALID_JOINTS,
        "the robot has no joint 'kne'; did you mean 'knee'? known: hip, knee",
    ),
    ({"joints": ["hip", "hip"]}, Code.INVALID_JOINTS, "joint 'hip' stands twice in the trajectory"),
    (
        {"joints": ["hip"]},
        Code.INVALID_JOINTS,
        "the trajectory lacks joint 'knee' (1 joints); name all, or say missing: hold in the map",
    ),
    (
        {"times": [], "positions": [], "velocities": [], "accelerations": []},
        Code.INVALID_GOAL,
        "the trajectory has no points",
    ),
    (
        {"times": list(range(1001))},
        Code.INVALID_GOAL,
        "the trajectory has 1001 points; at most 1000 are read",
    ),
    (
        {"times": [-0.5, 1]},
        Code.INVALID_GOAL,
        "the first point has the time -0.5 s; give 0 or more",
    ),
    (
        {"times": [1, 1]},
        Code.INVALID_GOAL,
        "times of points have to increase: point 0 is at 1 s, point 1 at 1 s",
    ),
    (
        {"times": [2, 1]},
        Code.INVALID_GOAL,
        "times of points have to increase: point 0 is at 2 s, point 1 at 1 s",
    ),
    ({"wait": -5.0}, Code.OLD_HEADER_TIMESTAMP, "the trajectory ended 3 s ago"),
    (
        {"wait": 1.7e9},
        Code.INVALID_GOAL,
        "the trajectory begins 1.7e+09 s from now; at most 60 are waited. Stamps are of /clock "
        "where a simulator runs (use_sim_time), else of the wall clock; 0 is now",
    ),
    (
        {"times": [1.0, 7200.0]},
        Code.INVALID_GOAL,
        "the trajectory takes 7200 s; at most 3600 are played",
    ),
    (
        {
            "times": [0.0],
            "positions": [[0.0, -1.0]],
            "velocities": [[]],
            "accelerations": [[]],
        },
        Code.INVALID_GOAL,
        "the trajectory ends at 0 s: its joints would have to jump; give it a time",
    ),
    (
        {"positions": [[0.5, -1.0], [0.0]]},
        Code.INVALID_GOAL,
        "point 1 has 1 positions for 2 joints",
    ),
    ({"positions": [[], [0.0, 0.0]]}, Code.INVALID_GOAL, "point 0 has 0 positions for 2 joints"),
    (
        {"velocities": [[0.0, 0.0, 0.0], []]},
        Code.INVALID_GOAL,
        "point 0 has 3 velocities for 2 joints",
    ),
    (
        {"positions": [[0.5, NAN], [0.0, -1.5]]},
        Code.INVALID_GOAL,
        "point 0 has positions that are not finite (knee)",
    ),
    (
        {"velocities": [[0.0, 0.0], [0.0, float("inf")]]},
        Code.INVALID_GOAL,
        "point 1 has velocities that are not finite (knee)",
    ),
    (
        {"efforts": [[], [1.0, 1.0]]},
        Code.INVALID_GOAL,
        "point 1 has efforts, which are not followed; leave them empty",
    ),
    (
        {"velocities": [[0.0, 0.0], [0.0, 0.5]]},
        Code.INVALID_GOAL,
        "the last point has a velocity (knee); a trajectory ends at rest",
    ),
    (
        {"positions": [[1.2, -1.0], [0.0, -1.5]]},
        Code.INVALID_GOAL,
        "hip would be at 1.200 rad after 1 s; allowed are -1.000 to 1.000",
    ),
    (
        {"times": [0.1, 2.0]},
        Code.INVALID_GOAL,
        "hip would have to move at 5 rad/s from 0 to 0.1 s; allowed are 2: give it more time",
    ),
    (
        {"times": [0.0, 2.0]},
        Code.INVALID_GOAL,
        "the first point, at 0 s, is 0.480 rad from where hip is (0.000 rad); allowed are 0.1 "
        "(start_tolerance): begin where the robot is, or give the first point a time",
    ),
]


@pytest.mark.parametrize(("changed", "code", "reason"), WRONG, ids=[w[2][:40] for w in WRONG])
def test_each_is_refused_with_one_line(changed: dict[str, Any], code: Code, reason: str) -> None:
    assert refusal(**changed) == (code, reason)


def test_a_cubic_that_overshoots_a_limit_is_refused() -> None:
    code, reason = refusal(
        times=[1.0, 2.0],
        positions=[[0.95, -1.0], [0.95, -1.0]],
        velocities=[[1.0, 0.0], [0.0, 0.0]],
        start=Start(np.array([0.0, -1.0]), np.zeros(2), np.zeros(2)),
    )
    assert code is Code.INVALID_GOAL
    assert reason.startswith("hip would be at 1.")


def test_a_cubic_whose_middle_is_too_fast_is_refused() -> None:
    """Its mean speed is 1.6 rad/s of the 2 allowed; a cubic from rest to rest has 2.4."""
    limits = replace(LIMITS, lower=np.array([-9.0, -9.0]), upper=np.array([9.0, 9.0]))
    changed = {"times": [1.0], "positions": [[1.6, -1.0]], "accelerations": [[]]}
    assert accepted(replace(GOOD, **changed, velocities=[[]]), limits, START)
    _, reason = refusal(limits, **changed, velocities=[[0.0, 0.0]])
    assert "hip would have to move at 2.4 rad/s" in reason


def test_joints_that_are_left_out_hold_where_that_is_allowed() -> None:
    points = replace(GOOD, joints=["knee"], positions=[[-1.5], [-1.2]])
    path = accepted(points, replace(LIMITS, partial=True), START)
    position, velocity = np.zeros(2), np.zeros(2)
    path.sample(1.0, position, velocity)
    assert position.tolist() == [0.0, -1.5]


def test_a_first_point_that_was_measured_is_where_the_joints_are() -> None:
    points = replace(GOOD, times=[0.0, 2.0], positions=[[0.02, -1.05], [0.0, -1.5]])
    path = accepted(points, LIMITS, START)
    position, velocity = np.zeros(2), np.zeros(2)
    path.sample(0.0, position, velocity)
    assert position.tolist() == [0.0, -1.0]  # the target does not jump to it


def test_what_is_past_is_left_out_and_the_rest_is_reached_from_here() -> None:
    points = replace(GOOD, wait=-1.2)
    path = accepted(points, LIMITS, START)
    assert path.times.tolist() == pytest.approx([0.0, 0.8])


def test_waiting_belongs_to_the_way_to_the_first_point() -> None:
    path = accepted(replace(GOOD, wait=2.0), LIMITS, START)
    assert path.times.tolist() == [0.0, 3.0, 4.0]


def test_a_joint_beyond_its_limit_may_come_back() -> None:
    start = Start(np.array([1.3, -1.0]), np.zeros(2), np.zeros(2))
    accepted(GOOD, LIMITS, start)


def test_what_moves_already_may_be_slowed_down() -> None:
    start = Start(np.array([0.0, -1.0]), np.array([2.0, 0.0]), np.zeros(2))
    points = replace(GOOD, positions=[[0.7, -1.0], [0.0, -1.5]], velocities=[[0.0, 0.0]] * 2)
    accepted(points, LIMITS, start)


def test_any_garbage_is_refused_or_stays_within_limits() -> None:
    """Of 3000 random trajectories none that is accepted leaves the limits or is too fast."""
    random = np.random.default_rng(0)
    taken = 0
    for _ in range(3000):
        count = int(random.integers(1, 5))
        times = np.sort(random.uniform(-0.2, 3.0, count)).tolist()
        rows = [
            random.normal([0.0, -1.0], scale, (count, 2)).tolist()
            for scale in random.choice([0.05, 0.3, 2.0], 3)
        ]
        rows[1] = [[]] * count if random.random() < 0.5 else np.subtract(rows[1], [0, -1]).tolist()
        rows[2] = [[]] * count
        if rows[1][-1]:
            rows[1][-1] = [0.0, 0.0]
        try:
            path = accepted(Points(JOINTS, times, *rows), LIMITS, START)
        except Refusal:
            continue
        taken += 1
        positions, speeds = path.within(np.linspace(0, 1, 33))
        assert (positions >= LIMITS.lower - 0.02).all()
        assert (positions <= LIMITS.upper + 0.02).all()
        assert (np.abs(speeds) <= LIMITS.speed * 1.05).all()
    assert 100 < taken < 2900
