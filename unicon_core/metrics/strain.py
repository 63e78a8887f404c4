"""What a robot bears: torques, temperatures, and when it falls. For each robot on its own.

Torques and temperatures need no shift: their statistics are compared, not their samples, and two
runs may be of different length.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from unicon_base.arrays import Float64
from unicon_base.errors import UniconError
from unicon_core.metrics.trajectories import one, refuse_period

LEANS = 0.8
"""Between the base's z axis and the vertical in [rad]: too far. `tilt_stop` ends a run at 1."""


@dataclass(frozen=True)
class Load:
    """Torque of each joint in [N·m]; arrays have shape (…, d).

    Attributes:
        rms: root of the mean square, which heats the windings.
        mean: with its sign, such as of a weight that is held.
        peak: largest |torque|.
    """

    rms: Float64
    mean: Float64
    peak: Float64


def load(torque: ArrayLike) -> Load:
    """Return what each joint had to bear.

    Args:
        torque: in [N·m], shape (…, n, d).

    Raises:
        UniconError: something that is not a number, or empty.
    """
    x = one(torque, "torque")
    return Load(np.sqrt(np.mean(x**2, axis=-2)), np.mean(x, axis=-2), np.max(np.abs(x), axis=-2))


@dataclass(frozen=True)
class Warming:
    """Temperature of each motor; arrays have shape (…, d).

    Attributes:
        start: in [°C].
        peak: in [°C].
        rise: from the first to the last sample in [K].
        rate: slope of the line of least squares in [K/s]; 0 for a single sample.
    """

    start: Float64
    peak: Float64
    rise: Float64
    rate: Float64


def warming(temperature: ArrayLike, period: float) -> Warming:
    """Return how each motor warmed.

    Args:
        temperature: in [°C], shape (…, n, d).
        period: between two samples in [s].

    Raises:
        UniconError: something that is not a number, or empty; a period that is not > 0.
    """
    x = one(temperature, "temperature")
    refuse_period(period)
    time = period * (np.arange(x.shape[-2]) - 0.5 * (x.shape[-2] - 1))
    spread = max(float(time @ time), np.finfo(np.float64).tiny)
    rate = np.einsum("n,...nd->...d", time, x - x[..., :1, :]) / spread
    first, last = x[..., 0, :], x[..., -1, :]
    return Warming(first.copy(), np.max(x, axis=-2), last - first, rate)


def compare(real: ArrayLike, sim: ArrayLike) -> Float64:
    """Return the ratio of two statistics, real / sim: 1 where both are 0, inf where only sim is."""
    a, b = (np.asarray(x, np.float64) for x in (real, sim))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio: Float64 = np.where((a == 0.0) & (b == 0.0), 1.0, a / b)
    return ratio


def fall_time(
    projected_gravity: ArrayLike, period: float, for_s: float = 0.1, whole: bool = False
) -> Float64:
    """Return when the base leaned too far and stayed there, in [s]; NaN where it did not fall.

    Args:
        projected_gravity: unit vector of gravity in the base frame, shape (…, n, 3).
        period: between two samples in [s].
        for_s: how long it stays so, in [s]; until the end counts too, since runs end with a fall.
        whole: the end does not count: it was not the fall that ended the run.

    Returns:
        Time of the first such sample, shape (…,).

    Raises:
        UniconError: something that is not a number, empty, or not of three elements; a period that
            is not > 0.
    """
    gravity = one(projected_gravity, "projected_gravity")
    if gravity.shape[-1] != 3:
        raise UniconError(f"gap: projected_gravity has {gravity.shape[-1]} elements; give x, y, z")
    refuse_period(period)
    leans = -gravity[..., 2] < math.cos(LEANS)
    held = max(1, round(for_s / period))
    count = leans.shape[-1]
    total = np.zeros((*leans.shape[:-1], count + 1), np.int64)
    np.cumsum(leans, axis=-1, out=total[..., 1:])
    ends = np.minimum(np.arange(count) + held, count)
    down = leans & (total[..., ends] - total[..., :count] == ends - np.arange(count))
    if whole:
        down[..., max(0, count - held + 1) :] = False
    return np.where(down.any(axis=-1), period * np.argmax(down, axis=-1), np.nan)
