"""Spline: it passes its knots with what they say, and the velocity is its derivative."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from unicon_core.trajectory.accepted import Spline

NONE = float("nan")
Float = NDArray[np.float64]


def spline(
    times: list[float], positions: list[float], velocities: list[float], acc: list[float]
) -> Spline:
    columns = (np.array(each, float)[:, None] for each in (positions, velocities, acc))
    return Spline(np.array(times), *columns)


def at(path: Spline, time: float) -> tuple[float, float]:
    position, velocity = np.zeros(1), np.zeros(1)
    path.sample(time, position, velocity)
    return float(position[0]), float(velocity[0])


def test_positions_alone_are_joined_by_lines() -> None:
    path = spline([0, 1, 3], [0, 1, 0], [NONE] * 3, [NONE] * 3)
    assert at(path, 0.25) == (0.25, 1.0)
    assert at(path, 2.0) == pytest.approx((0.5, -0.5))


def test_a_velocity_at_one_end_alone_does_not_count() -> None:
    path = spline([0, 1], [0, 1], [0, NONE], [NONE] * 2)
    assert at(path, 0.5) == (0.5, 1.0)


def test_behind_the_end_it_rests() -> None:
    path = spline([0, 1], [0, 1], [NONE] * 2, [NONE] * 2)
    assert at(path, 1.0) == (1.0, 0.0)
    assert at(path, 9.0) == (1.0, 0.0)


number = st.floats(-2, 2)
knots = st.lists(st.tuples(number, number, number), min_size=2, max_size=6)


@given(knots, st.lists(st.floats(0.3, 2), min_size=6, max_size=6), st.sampled_from([1, 2, 3]))
@settings(deadline=None, max_examples=60)
def test_it_passes_every_knot_with_what_the_knot_says(
    rows: list[tuple[float, float, float]], gaps: list[float], known: int
) -> None:
    times = np.concatenate([[0.0], np.cumsum(gaps[: len(rows) - 1])])
    values = np.array(rows)
    values[:, known:] = np.nan
    path = Spline(times, *(values[:, i : i + 1] for i in range(3)))
    step = 1e-6
    for i, time in enumerate(times[:-1]):
        position, velocity = at(path, float(time))
        assert position == pytest.approx(values[i, 0], abs=1e-9)
        if known > 1:
            assert velocity == pytest.approx(values[i, 1], abs=1e-9)
        after = at(path, float(time) + step)
        assert (after[0] - position) / step == pytest.approx(velocity, abs=1e-2)
        if known == 3:
            assert (after[1] - velocity) / step == pytest.approx(values[i, 2], abs=2e-1)
        before = at(path, float(times[i + 1]) - 1e-9)
        assert before[0] == pytest.approx(values[i + 1, 0], abs=1e-6)


@given(knots, st.sampled_from([1, 2, 3]))
@settings(deadline=None, max_examples=30)
def test_all_segments_at_once_are_what_each_is(
    rows: list[tuple[float, float, float]], known: int
) -> None:
    times = np.arange(len(rows)) * 0.5
    values = np.array(rows)
    values[:, known:] = np.nan
    path = Spline(times, *(values[:, i : i + 1] for i in range(3)))
    shares = np.array([0.0, 0.3, 0.9])
    positions, velocities = path.within(shares)
    for i in range(len(rows) - 1):
        for k, share in enumerate(shares):
            one = at(path, float(times[i] + 0.5 * share))
            assert (positions[i, k, 0], velocities[i, k, 0]) == pytest.approx(one, abs=1e-9)
