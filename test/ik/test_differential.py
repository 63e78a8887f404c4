"""DifferentialIk: joints come to targets, and break no limit whatever they are asked for."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from unicon_core.robots import Robot
from unicon_manipulation.ik.tasks import Weights

pytest.importorskip("daqp", reason="daqp is not installed: pip install 'unicon_ros[ik]'")

Build = Callable[..., Any]
HANDS = ("left_hand", "right_hand")


def random_target(rng: np.random.Generator, reach: float) -> Any:
    quat = rng.normal(size=4)
    return (reach * rng.normal(size=3)).tolist(), (quat / np.linalg.norm(quat)).tolist()


def limits_hold(it: Any, before: Any, after: Any) -> None:
    lower, upper = it.robot.lower[it.moved], it.robot.upper[it.moved]
    assert np.isfinite(after).all()
    assert (after >= lower).all()
    assert (after <= upper).all()
    assert np.abs(after - before).max() <= it.rate * it.period * (1.0 + 1e-9)


def test_a_target_within_reach_is_reached(arm: Robot, solved: Build) -> None:
    it, rng = solved(arm, apart=0.0, rate=3.0), np.random.default_rng(0)
    reached = 0
    for _ in range(20):
        near = it.pose[it.moved] + rng.uniform(-0.6, 0.6, 6)
        target = it.at(near)
        for _ in range(100):
            it.tick(target)
            if it.ik.reached[0]:
                break
        reached += it.ik.reached[0]
        assert it.ik.reached[0] == (it.ik.error[0][0] <= 0.005 and it.ik.error[0][1] <= 0.05)
    assert reached >= 19


def test_where_it_stays_the_error_is_gone(arm: Robot, solved: Build) -> None:
    it = solved(arm, apart=0.0)
    target = it.at(it.pose[it.moved] + 0.3)
    for _ in range(200):
        it.tick(target)
    far, wide = it.ik.error[0]
    assert far < 1e-4
    assert wide < 1e-3
    np.testing.assert_allclose(it.ik.step, 0.0, atol=1e-5)


def test_what_cannot_be_reached_is_told_and_comes_to_rest(arm: Robot, solved: Build) -> None:
    it = solved(arm)
    (x, y, z), quat = it.at(it.pose[it.moved])
    for _ in range(400):
        it.tick(((x + 3.0, y, z), quat))
    assert not it.ik.reached[0]
    assert it.ik.error[0][0] > 2.0
    assert np.abs(it.ik.step).max() < 1e-3


def test_noise_out_of_reach_does_not_shake_the_arm(arm: Robot, solved: Build) -> None:
    """Without damping by the error it is the full speed, 6 rad/s, in every tick."""
    it, rng = solved(arm, apart=0.0), np.random.default_rng(0)
    (x, y, z), quat = it.at(it.pose[it.moved])
    steps = []
    for i in range(300):
        place = np.array((x + 1.0, y, z)) + 1e-3 * rng.normal(size=3)
        it.tick((place.tolist(), quat))
        steps += [it.ik.step.copy()] if i > 150 else []
    assert np.sqrt(np.mean(np.square(steps))) / it.period < 0.3


@given(
    seed=st.integers(0, 10_000),
    rate=st.floats(0.1, 30.0),
    hertz=st.floats(50.0, 1000.0),
    reach=st.sampled_from([0.3, 1.0, 100.0, 1e15]),
)
@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_limits_are_never_broken(
    arm: Robot, solved: Build, seed: int, rate: float, hertz: float, reach: float
) -> None:
    it, rng = solved(arm, rate=rate, period=1.0 / hertz), np.random.default_rng(seed)
    it.ik.begin(rng.uniform(-4.0, 4.0, 6), np.ones(6, np.bool_))  # beyond the limits, too
    before = it.ik.pos.copy()
    for _ in range(40):
        after = it.tick(random_target(rng, reach) if rng.random() < 0.8 else None)
        limits_hold(it, before, after)
        before = after
    assert it.ik.failures == 0


def crossed(it: Any, seconds: float) -> float:
    """Push both hands through each other, slowly and by jumps; return the least distance in [m]."""
    homes, least = [it.at(it.ik.pos, i) for i in range(2)], np.inf
    for i in range(round(seconds / it.period)):
        slowly = i * it.period < 0.75 * seconds
        share = math.cos(math.pi * i * it.period) if slowly else 1 - 2 * (i // 25 % 2)
        targets = [((x, share * y, z), quat) for (x, y, z), quat in homes]
        before = it.ik.pos.copy()
        limits_hold(it, before, it.tick(*targets))
        least = min(least, it.distance())
    return least


@pytest.mark.parametrize("rate", [2.0, 6.0])
def test_crossing_hands_stay_apart(rate: float, g1: Robot, solved: Build) -> None:
    it = solved(g1, HANDS, ("arms",), rate=rate)
    assert crossed(it, 2.5) >= 0.010
    assert it.ik.failures == it.ik.halved == 0  # the rows alone have held them


def test_true_distances_hold_where_rows_do_not(g1: Robot, solved: Build) -> None:
    it = solved(g1, HANDS, ("arms",))
    it.ik._keep_apart = lambda apart: 0 * len(apart.rows())
    assert crossed(it, 2.0) >= 0.010
    assert it.ik.halved > 0


def pushed(it: Any) -> float:
    """Send the hand of an arm into its own pillar, from where it is; return the least distance."""
    _, quat = it.at(it.ik.pos)
    least = np.inf
    for i in range(150):
        place = ((0.0, 0.0, 0.05), (0.3, 0.2, 0.2), (0.05, -0.02, 0.02))[i // 50]
        it.tick((place, quat))
        least = min(least, it.distance())
    return least


@pytest.mark.parametrize("rate", [2.0, 6.0])
def test_rows_alone_keep_a_hand_off_its_own_arm(rate: float, arm: Robot, solved: Build) -> None:
    it = solved(arm, rate=rate, weights=Weights(orientation=0.0))
    assert pushed(it) >= 0.018
    assert it.ik.halved == 0


def test_true_distances_alone_keep_a_hand_off_its_own_arm(arm: Robot, solved: Build) -> None:
    it, free = (solved(arm, weights=Weights(orientation=0.0)) for _ in range(2))
    for each in (it, free):
        each.ik._keep_apart = lambda apart: 0 * len(apart.rows())
    free.ik._hold_back = lambda apart: None
    assert pushed(it) >= 0.010
    assert it.ik.halved > 0
    assert pushed(free) < -0.05


def test_without_distance_they_would_meet(g1: Robot, solved: Build) -> None:
    kept, it = solved(g1, HANDS, ("arms",)), solved(g1, HANDS, ("arms",), apart=0.0)
    it.reaching = kept.reaching  # whose pairs are looked at
    it.robot = kept.robot
    assert crossed(it, 2.0) < -0.03


def attacked(it: Any, ticks: int, seed: int) -> float:
    """Ask for random targets that jump in every tick; return the smallest distance in [m]."""
    rng, least = np.random.default_rng(seed), np.inf
    before = it.ik.pos.copy()
    for i in range(ticks):
        scale = rng.choice([0.2, 0.5, 3.0, 1e3])
        after = it.tick(*(random_target(rng, scale) for _ in range(len(it.ik.reached))))
        limits_hold(it, before, after)
        before = after
        if i % 10 == 0:
            least = min(least, it.distance())
    assert it.ik.failures == 0
    return least


def test_random_targets_break_nothing(g1: Robot, solved: Build) -> None:
    assert attacked(solved(g1, HANDS, ("arms",)), 2000, 0) >= 0.010


@pytest.mark.slow
@pytest.mark.parametrize("name", ["g1_29dof", "g1_23dof", "h1_2", "t1"])
def test_many_random_targets_break_nothing(name: str, assets: Any, solved: Build) -> None:
    from unicon_core.robots import load_robot

    it = solved(load_robot(name), HANDS, ("arms",))
    assert attacked(it, 100_000 if name == "g1_29dof" else 20_000, 1) >= 0.010


def test_what_is_too_near_already_comes_no_nearer(g1: Robot, solved: Build) -> None:
    it = solved(g1, HANDS, ("arms",))
    meeting = it.pose[it.moved].copy()
    meeting[2], meeting[9] = -0.9, 0.9  # shoulder yaws: forearms over each other
    it.ik.begin(meeting, np.ones(14, np.bool_))
    begun = it.distance()
    assert begun < 0.01
    homes = [it.at(it.pose[it.moved], i) for i in range(2)]
    through = [((x, -y, z), quat) for (x, y, z), quat in homes]
    for _ in range(60):
        it.tick(*through)
        assert it.distance() >= begun - 1e-6
    for _ in range(150):  # and may go away
        it.tick(*homes)
    assert it.distance() >= 0.019


def test_what_others_move_is_kept_away_from(arm: Robot, solved: Build) -> None:
    """The hand alone is moved; the lift, which is somebody else's, brings it near the pillar."""
    it = solved(arm, moves=("hand",))
    target = it.at(it.pose[it.moved])
    for lift in np.linspace(it.pose[1], 0.6, 60):
        it.pose[1] = lift
        limits_hold(it, it.ik.pos.copy(), it.tick(target))


def test_position_alone_leaves_the_orientation_free(arm: Robot, solved: Build) -> None:
    it = solved(arm, apart=0.0, weights=Weights(orientation=0.0))
    (x, y, z), _ = it.at(it.pose[it.moved])
    for _ in range(100):
        it.tick(((x - 0.05, y + 0.1, z), (0.0, 1.0, 0.0, 0.0)))
    assert it.ik.reached[0]
    assert it.ik.error[0][0] < 1e-3
    assert it.ik.error[0][1] > 0.1


def test_an_arm_of_fewer_joints_than_its_target_has_rows(arm: Robot, solved: Build) -> None:
    it = solved(arm, moves=("yaw", "lift", "elbow", "pitch"), apart=0.0)
    target = it.at(it.pose[it.moved] + [0.2, 0.1, -0.2, 0.3])
    for _ in range(150):
        it.tick(target)
    assert it.ik.reached[0]


def test_who_is_not_commanded_stands_where_it_is_measured(g1: Robot, solved: Build) -> None:
    it = solved(g1, HANDS, ("arms",))
    (x, y, z), quat = it.at(it.pose[it.moved])
    it.ik.activate(np.arange(14) < 7)
    it.pose[it.moved[7:]] = 0.1
    for _ in range(60):
        it.tick(((x + 0.05, y, z + 0.1), quat), None)
    assert it.ik.reached == [True, False]
    assert np.isnan(it.ik.error[1]).all()
    np.testing.assert_allclose(it.ik.pos[7:], 0.1)
    assert not it.ik.step[7:].any()


def test_the_default_pose_draws_what_is_left_free(arm: Robot, solved: Build) -> None:
    def elbow(posture: float) -> float:
        it = solved(arm, apart=0.0, posture=posture, weights=Weights(orientation=0.0))
        (x, y, z), quat = it.at(it.pose[it.moved])
        it.ik.begin(it.pose[it.moved] + [0, 0, 0, 1.0, 0, 1.0], np.ones(6, np.bool_))
        for _ in range(500):
            it.tick(((x, y, z), quat))
        assert it.ik.error[0][0] < 2e-3
        return float(np.abs(it.ik.pos - it.pose).max())

    assert elbow(0.02) < 0.1
    assert elbow(0.0) > 0.5
