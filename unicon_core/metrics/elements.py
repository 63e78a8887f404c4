"""Elements: how each simulated one maps onto the real one, and which goes with which.

`affine`: lag, gain, sign and offset, real[i + lag] ≈ gain · sim[i] + offset. A wrong sign, a wrong
unit, an encoder's zero and a delay each leave a mark of their own. `match_elements` finds swapped
legs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from unicon_base.arrays import Array, Float64, Int64
from unicon_core.metrics.alignment import admissible_shifts, correlations, two

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

    lag: Int64
    gain: Float64
    offset: Float64
    sign: Int64
    correlation: Float64


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

    def at(values: Array) -> Array:
        taken: Array = np.take_along_axis(values, best[..., None, :], axis=-2)[..., 0, :]
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


def windows(x: Float64, first: Int64, count: Int64 | int) -> Float64:
    """Return the sums of count[k] samples from first[k] on, shape (…, s, d)."""
    total = np.zeros((*x.shape[:-2], x.shape[-2] + 1, x.shape[-1]))
    np.cumsum(x, axis=-2, out=total[..., 1:, :])
    sums: Float64 = total[..., first + count, :] - total[..., first, :]
    return sums


CLEARLY = 0.5
"""The cost within a cycle is below that share of it as named. What differs less may be noise:
joints of a trot move in pairs."""


@dataclass(frozen=True)
class Matching:
    """Which element goes with which.

    Attributes:
        sim_from_real: element of sim that suits each of real, shape (…, d); a permutation.
        cost: mean squared difference under it, in the elements' unit², shape (…,).
        cost_as_named: the same with every element where it is, shape (…,).
        costs: of real element r with sim element s, shape (…, d, d).
    """

    sim_from_real: Int64
    cost: Float64
    cost_as_named: Float64
    costs: Float64

    def cycles(self) -> list[tuple[int, ...]]:
        """Return the elements that are swapped among each other; each tuple closes on itself.

        Of (0, 3) real 0 goes with sim 3 and real 3 with sim 0. For one pair of trajectories, not
        for a batch.
        """
        left, found = set(range(len(self.sim_from_real))), []
        while left:
            cycle = [min(left)]
            while (following := int(self.sim_from_real[cycle[-1]])) != cycle[0]:
                cycle.append(following)
            left -= set(cycle)
            matched = sum(self.costs[r, self.sim_from_real[r]] for r in cycle)
            if len(cycle) > 1 and matched < CLEARLY * sum(self.costs[r, r] for r in cycle):
                found.append(tuple(cycle))
        return found


def match_elements(real: ArrayLike, sim: ArrayLike) -> Matching:
    """Return the permutation of elements whose mean squared difference is smallest.

    Elements must have one unit. Bring the trajectories to one time before (`aligned_mse`). What
    is the same after a shift cannot be told from it: in a trot, left and right swapped are half a
    period.

    Args:
        real: shape (…, n, d).
        sim: of as many samples; leading axes are broadcast.

    Raises:
        UniconError: something that is not a number, empty, or shapes that do not fit.
    """
    a, b = two(real, sim, same_length=True)
    centre = 0.5 * (a.mean(axis=(-2, -1), keepdims=True) + b.mean(axis=(-2, -1), keepdims=True))
    a, b = a - centre, b - centre
    squares_a, squares_b = (np.einsum("...nd,...nd->...d", x, x) for x in (a, b))
    costs = (
        squares_a[..., :, None] + squares_b[..., None, :] - 2.0 * np.swapaxes(a, -1, -2) @ b
    ) / a.shape[-2]
    np.maximum(costs, 0.0, out=costs)
    chosen = np.zeros(costs.shape[:-1], np.int64)
    for index in np.ndindex(costs.shape[:-2]):
        chosen[index] = assign(costs[index])
    matched = np.take_along_axis(costs, chosen[..., None], axis=-1)[..., 0]
    named = np.diagonal(costs, axis1=-2, axis2=-1)
    return Matching(chosen, matched.mean(-1), named.mean(-1), costs)


def assign(costs: Float64) -> Int64:
    """Return the column of each row, each once, whose costs are the smallest in sum.

    The Hungarian method with potentials (Kuhn 1955, Munkres 1957), O(d³): rows come in one by one,
    each along the shortest way of exchanges.

    Args:
        costs: shape (d, d).
    """
    size = len(costs)
    row_price, column_price = np.zeros(size), np.zeros(size + 1)
    row_of = np.full(size + 1, -1)  # the last column stands for the row that comes in
    for row in range(size):
        row_of[size] = row
        column = size
        shortest, came_from = np.full(size, np.inf), np.full(size, size)
        seen = np.zeros(size + 1, np.bool_)
        while row_of[column] >= 0:
            seen[column] = True
            at = row_of[column]
            reduced = costs[at] - row_price[at] - column_price[:size]
            nearer = ~seen[:size] & (reduced < shortest)
            shortest[nearer], came_from[nearer] = reduced[nearer], column
            column_next = int(np.argmin(np.where(seen[:size], np.inf, shortest)))
            step = shortest[column_next]
            row_price[row_of[seen]] += step
            column_price[seen] -= step
            shortest[~seen[:size]] -= step
            column = column_next
        while column != size:
            row_of[column] = row_of[came_from[column]]
            column = int(came_from[column])
    column_of = np.zeros(size, np.int64)
    column_of[row_of[:size]] = np.arange(size)
    return column_of
