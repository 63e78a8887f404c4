"""Resampling: straight lines stay, means are those of the line, noise does not fold."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from unicon_lab.analysis.paired_runs import resample


@given(st.integers(0, 2**32 - 1), st.integers(20, 60), st.floats(0.3, 6.0))
@settings(max_examples=30)
def test_a_value_is_the_mean_of_the_line_around_it(seed: int, count: int, factor: float) -> None:
    random = np.random.default_rng(seed)
    time = np.cumsum(random.uniform(0.5, 1.5, count))
    values = random.normal(size=(count, 2))
    period = factor * float(np.median(np.diff(time)))
    found = resample(time, {"x": values}, period)["x"]
    grid = time[0] + period * np.arange(len(found))
    assert grid[-1] <= time[-1] + 1e-6 < grid[-1] + period + 1e-5
    for at, row in zip(grid, found):
        span = period if factor > 1.5 else 0.0
        dense = np.linspace(max(at - span / 2, time[0]), min(at + span / 2, time[-1]), 4001)
        for k in range(2):
            line = np.interp(dense, time, values[:, k])
            mean = float(np.mean(0.5 * (line[1:] + line[:-1]))) if span else line[0]
            assert row[k] == pytest.approx(mean, abs=1e-4)


@pytest.mark.parametrize("period", [0.004, 0.02, 0.05])
def test_a_straight_line_stays_straight_far_from_zero(period: float) -> None:
    time = 0.01 * np.arange(500)
    found = resample(time, {"x": 1e6 + 3.0 * time[:, None]}, period)["x"][:, 0]
    inner = slice(3, -3)  # at the ends the mean is of half a period
    expected = 1e6 + 3.0 * period * np.arange(len(found))
    np.testing.assert_allclose(found[inner], expected[inner], atol=1e-8)


def test_a_hum_above_the_new_rate_is_not_folded_into_it() -> None:
    time = 0.002 * np.arange(5000)
    hum = np.sin(2 * np.pi * 51.0 * time)[:, None]  # would look like 1 Hz at 50 Hz
    assert np.abs(resample(time, {"x": hum}, 0.02)["x"][1:-1]).max() < 0.1
