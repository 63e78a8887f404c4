"""Matching of elements: which simulated joint moves as the real one does; finds swapped legs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from unicon_core.gap.trajectories import Array, two

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

    sim_from_real: NDArray[np.int64]
    cost: Array
    cost_as_named: Array
    costs: Array

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


def assign(costs: Array) -> NDArray[np.int64]:
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
