"""Resampling of two runs to one rate, for their comparison sample by sample."""

from __future__ import annotations

import numpy as np

from unicon_core.gap.trajectories import Array
from unicon_ros.analysis.run import Run

LONGEST = 300_000
"""Samples that are compared: 10 minutes at 500 Hz; longer runs are thinned out evenly."""
SAME_RATE = 1e-3
"""Share by which two periods may differ and still be one: 1 ms a second."""
EVEN = 0.25
"""Periods by which a sample may be early or late and its run still be even."""
SMOOTHED = 1.5
"""Old periods in a new one from which on values are averaged."""


def common_period(real: Run, sim: Run, rate: float | None) -> tuple[float, str]:
    """Return the period in [s] at which two runs are compared, and how they come to it.

    Args:
        real: one run.
        sim: the other.
        rate: that was asked for in [Hz]; None for the slower one's.

    Returns:
        The method is in words; "" where both can stay as they are.
    """
    periods, even = zip(*(_own_period(run.time) for run in (real, sim)))
    period = 1.0 / rate if rate else max(periods)
    longest = max(float(run.time[-1]) for run in (real, sim))
    too_many = longest / period > LONGEST
    if too_many:
        period = longest / LONGEST
    if all(even) and all(abs(own - period) <= SAME_RATE * period for own in periods):
        return period, ""
    rates = [f"{1.0 / own:.4g} Hz" for own in periods]
    text = f"the real run ({rates[0]}) and the simulated one ({rates[1]}) were resampled "
    text += f"to {1.0 / period:.4g} Hz, linearly"
    names = ("the real", "the simulated")
    if smoothed := [name for name, own in zip(names, periods) if period > SMOOTHED * own]:
        text += f"; before that {' and '.join(smoothed)} one was averaged over each new period"
    if too_many:
        text += f"; at no higher rate, since {LONGEST:,} samples are compared at most"
    return period, text


def _own_period(time: Array) -> tuple[float, bool]:
    """Return the period of a run's samples, and whether all stand where it puts them."""
    mean = float(time[-1]) / (len(time) - 1)
    if np.abs(time - mean * np.arange(len(time))).max() <= EVEN * mean:
        return mean, True
    steps = np.diff(time)
    return float(np.mean(steps[steps < 3.0 * np.median(steps)])), False  # holes are not a rate


def resample(time: Array, states: dict[str, Array], period: float) -> dict[str, Array]:
    """Return the states at even times from the first sample on.

    Linear interpolation. Where the new period is longer than `SMOOTHED` of the old ones, each value
    is the mean of that line over one period around it: noise does not fold into what is left.

    Args:
        time: of the samples in [s], rising, shape (n,).
        states: name to values, shape (n, d).
        period: of the result in [s].
    """
    grid = time[0] + period * np.arange(int((time[-1] - time[0]) / period + 1e-6) + 1)
    if period <= SMOOTHED * float(np.median(np.diff(time))):
        return {name: _linear(grid, time, values) for name, values in states.items()}
    low, high = np.maximum(grid - period / 2, time[0]), np.minimum(grid + period / 2, time[-1])
    result = {}
    for name, values in states.items():
        middle = values.mean(axis=0)
        areas = np.zeros_like(values)
        steps = 0.5 * np.diff(time)[:, None] * (values[1:] + values[:-1] - 2 * middle)
        np.cumsum(steps, axis=0, out=areas[1:])
        area = _integral(high, time, values - middle, areas) - _integral(
            low, time, values - middle, areas
        )
        result[name] = middle + area / (high - low)[:, None]
    return result


def _linear(at: Array, time: Array, values: Array) -> Array:
    """Return the straight lines between the samples, shape (len(at), d)."""
    return np.stack([np.interp(at, time, column) for column in values.T], axis=1)


def _integral(at: Array, time: Array, values: Array, areas: Array) -> Array:
    """Return the area below these lines up to each time; `areas` are those at the samples."""
    row = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(time) - 2)
    inside = (at - time[row])[:, None]
    slope = (values[row + 1] - values[row]) / (time[row + 1] - time[row])[:, None]
    area: Array = areas[row] + inside * (values[row] + 0.5 * slope * inside)
    return area
