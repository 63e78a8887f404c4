"""Lag, gain, sign and offset of each element: real[i + lag] ≈ gain · sim[i] + offset.

A wrong sign, a wrong unit, an encoder's zero and a delay each leave a mark of their own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from unicon_core.gap.alignment import admissible_shifts, correlations
from unicon_core.gap.trajectories import Array, two

STILL = 1e-7
"""Share of an element's largest number below which its spread is rounding: float32 has 1e-7."""

TIE = 1e-9
"""Of a correlation: where two lags are as good, the smaller one counts."""


@dataclass(frozen=True)
class Affine:
    """What maps each simulated element onto the real one; arrays have shape (…, d).

    Attributes:
        lag: in samples, of the largest |correlation|; real is later where it is > 0.
        gain: of least squares at that lag. NaN where the simulated one stands still.
        offset: in the elements' unit. Where one of both stands still, the difference of means.
        sign: −1 where real moves against sim, 1 where with it, 0 where one of both stands still.
        correlation: Pearson's at that lag, in [−1, 1]; NaN where one of both stands still.
    """

    lag: NDArray[np.int64]
    gain: Array
    offset: Array
    sign: NDArray[np.int64]
    correlation: Array


def affine(real: ArrayLike, sim: ArrayLike, max_lag: int | None = None) -> Affine:
    """Return lag, gain, sign and offset of each element on its own.

    What repeats, such as a walk, looks alike after half a period with the sign turned: keep
    `max_lag` below a quarter of the period.

    Args:
        real: shape (…, n, d).
        sim: shape (…, m, d); leading axes are broadcast.
        max_lag: largest |lag| in samples; None for all that leave half of the shorter trajectory.

    Raises:
        UniconError: something that is not a number, empty, or shapes that do not fit.
    """
    a, b = two(real, sim)
    shifts, overlaps = admissible_shifts(a.shape[-2], b.shape[-2], max_lag)
    mean_a, mean_b = (x.mean(axis=-2, keepdims=True) for x in (a, b))
    # What is farther from zero than it moves has its rounding from there.
    still_a, still_b = (STILL * np.max(np.abs(x), axis=-2, keepdims=True) for x in (a, b))
    a, b = a - mean_a, b - mean_b
    first_a, first_b, count = np.maximum(shifts, 0), np.maximum(-shifts, 0), overlaps[:, None]
    sum_a, sum_b = windows(a, first_a, overlaps), windows(b, first_b, overlaps)
    var_a = windows(a * a, first_a, overlaps) / count - (sum_a / count) ** 2
    var_b = windows(b * b, first_b, overlaps) / count - (sum_b / count) ** 2
    covariance = correlations(a, b, shifts) / count - sum_a * sum_b / count**2
    moves_a, moves_b = var_a > still_a**2, var_b > still_b**2
    moves = moves_a & moves_b
    found = np.where(
        moves, covariance / np.sqrt(np.where(moves, var_a, 1.0) * np.where(moves, var_b, 1.0)), 0.0
    )
    order = np.argsort(np.abs(shifts), kind="stable")
    strength = np.abs(found[..., order, :])
    best = order[np.argmax(strength >= strength.max(axis=-2, keepdims=True) - TIE, axis=-2)]

    def at(values: NDArray[Any]) -> NDArray[Any]:
        taken: NDArray[Any] = np.take_along_axis(values, best[..., None, :], axis=-2)[..., 0, :]
        return taken

    both, with_sim = at(moves), at(moves_b)
    pairs = overlaps[best]
    gain = np.where(with_sim, at(covariance) / np.where(with_sim, at(var_b), 1.0), np.nan)
    offset = (
        mean_a[..., 0, :]
        + at(sum_a) / pairs
        - np.where(both, gain, 1.0) * (mean_b[..., 0, :] + at(sum_b) / pairs)
    )
    correlation = np.where(both, np.clip(at(found), -1.0, 1.0), np.nan)
    sign = np.where(both, np.sign(at(found)), 0.0).astype(np.int64)
    return Affine(shifts[best], gain, offset, sign, correlation)


def windows(x: Array, first: NDArray[np.int64], count: NDArray[np.int64] | int) -> Array:
    """Return the sums of count[k] samples from first[k] on, shape (…, s, d)."""
    total = np.zeros((*x.shape[:-2], x.shape[-2] + 1, x.shape[-1]))
    np.cumsum(x, axis=-2, out=total[..., 1:, :])
    sums: Array = total[..., first + count, :] - total[..., first, :]
    return sums
