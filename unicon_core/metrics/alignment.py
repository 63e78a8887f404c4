"""Aligned MSE: the loss between two trajectories at the one shift in time that suits them best.

    L = 2/n min_j Σ_i ‖T[i+j] − T̂[i]‖²

It is made after the equation of the UniCon paper, 1/n min_j Σ ‖T[i+j] − T̂[i]‖ + 1/n min_j Σ
‖T[i] − T̂[i+j]‖, for fits and twins, which need that shift; `unfolded_mse` is what the authors'
code computes. How its open ends are tied here:

- *Index past the end.* A pair exists where both indices do (the overlap); nothing is padded and
  nothing wraps around.
- *Normalisation.* n is the number of pairs of the shift at hand. With a fixed n the shift with the
  fewest pairs would win.
- *Range of j.* Every shift, of either sign, that leaves `min_overlap` of the shorter trajectory.
  Only then is a delayed copy at loss 0. The second sum at j has the pairs of the first at −j, so
  that both minima are one number, and L is twice that. It follows that L is symmetric.
- *Among equals* the smallest |j| counts, for constant trajectories 0.

Squares make all shifts at once a correlation: O(n log n).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from unicon_base import UniconError
from unicon_base.arrays import Float64, Int64

LARGEST = 1e100
"""Of an element: its square, summed over any recording, is still a number."""


def one(values: ArrayLike, name: str) -> Float64:
    """Return a trajectory as float64, shape (…, n, d).

    Args:
        values: of numbers, shape (…, n, d).
        name: that an error calls it.

    Raises:
        UniconError: it lacks an axis, is empty, or has something in it that is not a number.
    """
    try:
        array = np.asarray(values, np.float64)
    except (TypeError, ValueError):
        raise UniconError(f"gap: {name} has something else than numbers in it") from None
    if array.ndim < 2:
        raise UniconError(
            f"gap: {name} has shape {array.shape}, not (…, samples, elements); "
            "one element over time is values[:, None]"
        )
    if 0 in array.shape:
        raise UniconError(f"gap: {name} is empty, shape {array.shape}; give at least one sample")
    # One pass for all that is well: NaN compares as False.
    if not (np.max(np.abs(array)) < LARGEST):
        bad = tuple(map(int, np.argwhere(~(np.abs(array) < LARGEST))[0]))
        of = f" of trajectory {bad[:-2] if len(bad) > 3 else bad[0]}" if len(bad) > 2 else ""
        raise UniconError(
            f"gap: {name} is {array[bad]} in sample {bad[-2]}, element {bad[-1]}"
            f"{of}; leave such samples out, or fill them in"
        )
    return array


def two(real: ArrayLike, sim: ArrayLike, same_length: bool = False) -> tuple[Float64, Float64]:
    """Return both trajectories as float64; their leading axes are broadcast.

    Args:
        real: shape (…, n, d).
        sim: shape (…, m, d).
        same_length: whether m must be n.

    Raises:
        UniconError: one of them is wrong, or they do not fit each other.
    """
    a, b = one(real, "real"), one(sim, "sim")
    if a.shape[-1] != b.shape[-1]:
        raise UniconError(
            f"gap: real has {a.shape[-1]} elements, sim {b.shape[-1]}; choose those in common"
        )
    if same_length and a.shape[-2] != b.shape[-2]:
        raise UniconError(
            f"gap: real has {a.shape[-2]} samples, sim {b.shape[-2]}; "
            "cut them to one length, or shift them with aligned_mse"
        )
    try:
        front = np.broadcast_shapes(a.shape[:-2], b.shape[:-2])
    except ValueError:
        raise UniconError(
            f"gap: real has shape {a.shape}, sim {b.shape}; "
            "the axes before (samples, elements) must be alike"
        ) from None
    return (
        np.broadcast_to(a, (*front, *a.shape[-2:])),
        np.broadcast_to(b, (*front, *b.shape[-2:])),
    )


def refuse_period(period: float) -> None:
    """Refuse a time between two samples that is none.

    Raises:
        UniconError: it is not > 0, or has no end.
    """
    if not 0.0 < period < math.inf:
        raise UniconError(f"gap: period is {period}; give a time > 0 in [s]")


CANDIDATES = 16
"""Shifts that are compared once more, to the last bit, where rounding hides which is best."""

AT_ONCE = 1 << 22
"""Numbers that are transformed at once: 32 MiB."""


@dataclass(frozen=True)
class Aligned:
    """A loss and where it was found; each array has the leading axes of the trajectories, (…,).

    Attributes:
        loss: twice the mean of ‖real[i + j] − sim[i]‖², in unit² of the elements, summed over them.
        shift: j in samples: real[i + j] goes with sim[i], so real is later where j > 0.
        overlap: number of pairs.
    """

    loss: Float64
    shift: Int64
    overlap: Int64


def admissible_shifts(
    n: int, m: int, max_shift: int | None = None, min_overlap: float = 0.5
) -> tuple[Int64, Int64]:
    """Return the shifts j that leave enough pairs real[i + j], sim[i], and how many each leaves.

    Args:
        n: samples of real.
        m: samples of sim.
        max_shift: largest |j|; None for all.
        min_overlap: share of the shorter trajectory that must have pairs, in (0, 1].

    Raises:
        UniconError: an argument is out of range.
    """
    if not 0.0 < min_overlap <= 1.0:
        raise UniconError(f"gap: min_overlap is {min_overlap}; give a share in (0, 1]")
    if max_shift is not None and max_shift < 0:
        raise UniconError(f"gap: max_shift is {max_shift}; give a number of samples >= 0")
    least = max(1, math.ceil(min_overlap * min(n, m)))
    low, high = least - m, n - least
    if max_shift is not None:
        low, high = max(low, -max_shift), min(high, max_shift)
    shifts = np.arange(low, high + 1)
    return shifts, np.minimum(n, m + shifts) - np.maximum(0, shifts)


def aligned_mse(
    real: ArrayLike, sim: ArrayLike, max_shift: int | None = None, min_overlap: float = 0.5
) -> Aligned:
    """Return the aligned MSE, over all admissible shifts.

    O(n log n) for each trajectory. Of each element on its own: `aligned_mse(real.T[..., None],
    sim.T[..., None])`, whose result has shape (d,).

    Args:
        real: T, shape (…, n, d).
        sim: T̂, shape (…, m, d); leading axes are broadcast.
        max_shift: largest |j| in samples; None for all.
        min_overlap: share of the shorter trajectory that must have pairs, in (0, 1].

    Raises:
        UniconError: something that is not a number, empty, or shapes that do not fit.
    """
    a, b = two(real, sim)
    shifts, overlaps = admissible_shifts(a.shape[-2], b.shape[-2], max_shift, min_overlap)
    means, best = smallest_means(a, b, shifts, overlaps)
    return Aligned(2.0 * means, shifts[best], overlaps[best])


def smallest_means(a: Float64, b: Float64, shifts: Int64, overlaps: Int64) -> tuple[Float64, Int64]:
    """Return the smallest mean of ‖a[i + j] − b[i]‖² over all pairs, and the index of its shift.

    Args:
        a: shape (…, n, d).
        b: shape (…, m, d), with the same leading axes.
        shifts: consecutive j, shape (s,).
        overlaps: number of pairs of each, shape (s,).

    Returns:
        Both of shape (…,).
    """
    front = a.shape[:-2]
    a, b = a.reshape(-1, *a.shape[-2:]), b.reshape(-1, *b.shape[-2:])
    step = max(1, AT_ONCE // (2 * max(a.shape[-2], b.shape[-2]) * a.shape[-1]))
    smallest, best = np.zeros(len(a)), np.zeros(len(a), np.int64)
    for start in range(0, len(a), step):
        part = slice(start, start + step)
        means, errors = _mean_squares(a[part], b[part], shifts, overlaps)
        for row, (mean, error) in enumerate(zip(means, errors), start):
            smallest[row], best[row] = _smallest(a[row], b[row], shifts, mean, error)
    return smallest.reshape(front), best.reshape(front)


def shift_losses(
    real: ArrayLike, sim: ArrayLike, max_shift: int | None = None, min_overlap: float = 0.5
) -> tuple[Int64, Float64]:
    """Return every admissible shift and the loss there, to be drawn.

    The smallest is `aligned_mse`'s, up to a rounding error of 1e-13 of the signals' energy.

    Args:
        real: T, shape (n, d).
        sim: T̂, shape (m, d).
        max_shift: largest |j| in samples; None for all.
        min_overlap: share of the shorter trajectory that must have pairs, in (0, 1].

    Returns:
        Both of shape (s,).

    Raises:
        UniconError: something that is not a number, empty, or shapes that do not fit.
    """
    a, b = two(real, sim)
    shifts, overlaps = admissible_shifts(a.shape[-2], b.shape[-2], max_shift, min_overlap)
    means, _ = _mean_squares(a[None], b[None], shifts, overlaps)
    return shifts, np.maximum(2.0 * means[0], 0.0)


def correlations(a: Float64, b: Float64, shifts: Int64, summed: bool = False) -> Float64:
    """Return Σ_i a[i + j] b[i] over the overlap, for consecutive shifts j.

    The error of each element stays below some 1e-14 √(Σa² Σb²).

    Args:
        a: shape (…, n, d).
        b: shape (…, m, d).
        shifts: consecutive j, shape (s,).
        summed: over the elements, at the price of one inverse transform instead of d.

    Returns:
        Shape (…, s, d), summed (…, s, 1).
    """
    n, m = a.shape[-2], b.shape[-2]
    # So much room that no wanted shift meets the one that is a whole transform away.
    least = max(int(shifts[-1]) + m, n - int(shifts[0]))
    # The smallest 2^p, 3·2^p or 5·2^p that is not below: quick to transform.
    size = min(factor << max(0, math.ceil(math.log2(least / factor))) for factor in (1, 3, 5))
    if not summed:
        product = _cross_spectrum(a, b, size)
    else:  # an element after the other: a transform of 300,000 × 30 samples takes 300 MB
        product = _cross_spectrum(a[..., :1], b[..., :1], size)
        for k in range(1, a.shape[-1]):
            product += _cross_spectrum(a[..., k : k + 1], b[..., k : k + 1], size)
    return np.take(np.fft.irfft(product, size, axis=-2), shifts % size, axis=-2)


def _cross_spectrum(a: Float64, b: Float64, size: int) -> NDArray[np.complex128]:
    product = np.fft.rfft(a, size, axis=-2)
    product *= np.conj(np.fft.rfft(b, size, axis=-2))
    return product


def _mean_squares(
    a: Float64, b: Float64, shifts: Int64, overlaps: Int64
) -> tuple[Float64, Float64]:
    """Return the mean of ‖a[i + j] − b[i]‖² at each shift and the bound of its rounding error.

    Σ‖a − b‖² = Σ‖a‖² + Σ‖b‖² − 2 Σ a·b; the sums of squares are differences of cumulative ones.

    Returns:
        Both of shape (c, s), of c pairs of trajectories.
    """
    # What both have in common, such as a posture far from zero, would only cost digits.
    centre = 0.5 * (a.mean(axis=-2, keepdims=True) + b.mean(axis=-2, keepdims=True))
    a, b = a - centre, b - centre
    sums = [np.zeros((len(x), x.shape[1] + 1)) for x in (a, b)]
    for total, x in zip(sums, (a, b)):
        np.cumsum(np.einsum("cnd,cnd->cn", x, x), axis=-1, out=total[:, 1:])
    first_a, first_b = np.maximum(shifts, 0), np.maximum(-shifts, 0)
    squares = (
        sums[0][:, first_a + overlaps]
        - sums[0][:, first_a]
        + sums[1][:, first_b + overlaps]
        - sums[1][:, first_b]
    )
    means = (squares - 2.0 * correlations(a, b, shifts, summed=True)[..., 0]) / overlaps
    energy = sums[0][:, -1:] + sums[1][:, -1:]
    return means, 64.0 * np.finfo(np.float64).eps * energy / overlaps


def _smallest(
    a: Float64, b: Float64, shifts: Int64, means: Float64, errors: Float64
) -> tuple[float, int]:
    """Return the smallest mean of squares, directly computed, and the index of its shift.

    Args:
        a: one trajectory, shape (n, d).
        b: the other, shape (m, d).
        shifts: shape (s,).
        means: about the mean at each of them, shape (s,).
        errors: how far off those may be, shape (s,).
    """
    possible = np.flatnonzero(means - errors <= np.min(means + errors))
    order = np.argsort(np.abs(shifts[possible]), kind="stable")
    found = []
    for index in possible[order][:CANDIDATES]:
        shift = int(shifts[index])
        begin, end = max(0, -shift), min(len(b), len(a) - shift)
        apart = a[begin + shift : end + shift] - b[begin:end]
        found.append((float(np.einsum("nd,nd->", apart, apart)) / len(apart), int(index)))
    return min(found, key=lambda pair: pair[0])
