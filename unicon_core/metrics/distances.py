"""Distances: mean squared errors sample by sample, the unfolded MSE, and three that know no time.

The unfolded MSE is the loss of the UniCon paper, as its authors' code computes it:

`unfolded_mse_loss` of `unicon/losses.py` in https://github.com/CreeperLin/unicon (commit 5c648bf),
with its defaults: a window of half of the samples is slid over one trajectory and held against the
beginning of the other one. The smallest mean of squares over all places of the window counts, in
both directions by half:

    L = ½ min_p mean (T̂[p : p+w] − T[: w])² + ½ min_p mean (T[p : p+w] − T̂[: w])²,  w = ⌊m/2⌋

Means are over samples and elements. Places begin at 0 and are sought in each direction by itself.
A copy that is late by up to half of the samples costs nothing in one direction; in the other one it
costs what its beginning lacks, unless the movement repeats.

Chamfer of the paths, distance of the spectra and of the distributions stay small where the robot
does the same at other moments, and grow where it does something else: with the aligned MSE they
tell "later" from "otherwise".
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from unicon_base import UniconError
from unicon_base.arrays import Float64
from unicon_core.metrics.alignment import one, refuse_period, smallest_means, two

_AXES = {"all": (-2, -1), "element": (-2,), "frame": (-1,)}


def mse(real: ArrayLike, sim: ArrayLike, per: str = "all") -> Float64:
    """Return the mean of (real − sim)², in the elements' unit².

    The aligned MSE sums over elements and takes both directions: where the best shift is 0, it is
    2·d times `mse` over all.

    Args:
        real: shape (…, n, d).
        sim: of as many samples; leading axes are broadcast.
        per: `all`: one value, shape (…,); `element`: (…, d); `frame`: one a sample, (…, n).

    Raises:
        UniconError: something that is not a number, empty, or shapes that do not fit.
    """
    if per not in _AXES:
        raise UniconError(f"gap: per is {per!r}; give one of {', '.join(_AXES)}")
    a, b = two(real, sim, same_length=True)
    means: Float64 = np.mean((a - b) ** 2, axis=_AXES[per])
    return means


def rmse(real: ArrayLike, sim: ArrayLike, per: str = "all") -> Float64:
    """Return the root of `mse`, in the elements' unit; the same arguments, shapes and errors."""
    root: Float64 = np.sqrt(mse(real, sim, per))
    return root


def unfolded_mse(real: ArrayLike, sim: ArrayLike) -> Float64:
    """Return the unfolded MSE in the elements' unit², shape (…,).

    O(n log n) for each trajectory.

    Args:
        real: T, shape (…, n, d).
        sim: T̂, shape (…, m, d), whose half is the window; leading axes are broadcast.

    Raises:
        UniconError: something that is not a number, empty, shapes that do not fit, or no window.
    """
    a, b = two(real, sim)
    window = b.shape[-2] // 2
    if not 1 <= window <= a.shape[-2]:
        raise UniconError(
            f"gap: real has {a.shape[-2]} samples, sim {b.shape[-2]}; sim must have at least 2, "
            "and real half as many as sim"
        )
    losses = np.zeros(a.shape[:-2])
    for slid, held in ((a, b), (b, a)):
        shifts = np.arange(slid.shape[-2] - window + 1)
        pairs = np.full(len(shifts), window)
        losses += smallest_means(slid, held[..., :window, :], shifts, pairs)[0]
    losses /= 2.0 * a.shape[-1]
    return losses


ROWS = 512
"""Samples whose distances to all others are held at once."""


def chamfer(real: ArrayLike, sim: ArrayLike) -> Float64:
    """Return the mean distance from each sample to the nearest of the other, both ways summed.

    Symmetric, and 0 where both visit the same postures in whatever order. O(n · m · d); a shared
    factor of ten fewer samples is a hundred times quicker.

    Args:
        real: shape (…, n, d).
        sim: shape (…, m, d); leading axes are broadcast.

    Returns:
        In the elements' unit, shape (…,).

    Raises:
        UniconError: something that is not a number, empty, or shapes that do not fit.
    """
    a, b = two(real, sim)
    distances = np.zeros(a.shape[:-2])
    for index in np.ndindex(distances.shape):
        distances[index] = _nearest(a[index], b[index]) + _nearest(b[index], a[index])
    return distances


def _nearest(a: Float64, b: Float64) -> float:
    """Return the mean distance from each row of a to the nearest row of b."""
    centre = 0.5 * (a.mean(axis=0) + b.mean(axis=0))
    far_b = b - centre
    squares = np.einsum("md,md->m", far_b, far_b)
    total = 0.0
    for start in range(0, len(a), ROWS):
        rows = a[start : start + ROWS]
        # ‖a − b‖² − ‖a‖²: enough to find who is nearest; how near is then computed directly.
        nearest = np.argmin(squares - 2.0 * (rows - centre) @ far_b.T, axis=1)
        total += float(np.linalg.norm(rows - b[nearest], axis=1).sum())
    return total / len(a)


def spectral_distance(real: ArrayLike, sim: ArrayLike, samples: int = 256) -> Float64:
    """Return how much the power spectra of each element differ, from 0 to 1.

        D = Σ_f (√P − √Q)² / Σ_f (P + Q)

    P and Q are mean power spectra of segments that overlap by half, each without its mean and under
    Hann's window (Welch 1967). 0: the same oscillations, whenever they were; 1: no frequency in
    common, or one of both stands still. Both still: 0.

    Args:
        real: shape (…, n, d).
        sim: shape (…, m, d); leading axes are broadcast.
        samples: of a segment; fewer where a trajectory is shorter. At least 2.

    Returns:
        Shape (…, d).

    Raises:
        UniconError: something that is not a number, empty, or shapes that do not fit.
    """
    a, b = two(real, sim)
    if samples < 2:
        raise UniconError(f"gap: samples is {samples}; a segment has at least 2")
    length = min(samples, a.shape[-2], b.shape[-2])
    p, q = _power(a, length), _power(b, length)
    whole = np.sum(p + q, axis=-2)
    apart = np.sum((np.sqrt(p) - np.sqrt(q)) ** 2, axis=-2)
    distance: Float64 = np.divide(apart, whole, out=np.zeros_like(whole), where=whole > 0.0)
    return distance


def wasserstein(real: ArrayLike, sim: ArrayLike) -> Float64:
    """Return how far the distribution of each element must be moved to be the other's.

    The Wasserstein-1 distance: the mean difference of the sorted samples. A shift in time, or a
    step that comes at another moment, changes nothing in it.

    Args:
        real: shape (…, n, d).
        sim: shape (…, m, d); leading axes are broadcast.

    Returns:
        In the elements' unit, shape (…, d).

    Raises:
        UniconError: something that is not a number, empty, or shapes that do not fit.
    """
    a, b = (np.sort(x, axis=-2) for x in two(real, sim))
    n, m = a.shape[-2], b.shape[-2]
    # Both quantile functions are constant between these shares, in units of 1 / (n m).
    shares = np.union1d(np.arange(n + 1) * m, np.arange(m + 1) * n)
    apart = np.abs(a[..., shares[:-1] // m, :] - b[..., shares[:-1] // n, :])
    distance: Float64 = np.einsum("s,...sd->...d", np.diff(shares) / (n * m), apart)
    return distance


def _power(x: Float64, length: int) -> Float64:
    """Return the mean power spectrum of segments, shape (…, frequencies, d)."""
    starts = np.arange(0, x.shape[-2] - length + 1, max(1, length // 2))
    window = np.sin(np.pi * (np.arange(length) + 0.5) / length)[:, None] ** 2
    total = np.zeros((*x.shape[:-2], length // 2 + 1, x.shape[-1]))
    for start in starts:
        part = x[..., start : start + length, :]
        middle = part.mean(axis=-2, keepdims=True)
        moved = part - middle
        # A constant minus its mean may leave a last bit, which is not an oscillation.
        moved[np.abs(moved) <= 1e-12 * np.abs(middle)] = 0.0
        total += np.abs(np.fft.rfft(moved * window, axis=-2)) ** 2
    return total / len(starts)


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
