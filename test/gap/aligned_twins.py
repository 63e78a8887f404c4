"""The MSEs with shifts, word for word in loops: what the fast functions are held against."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


def admissible(n: int, m: int, max_shift: int | None, min_overlap: float) -> list[int]:
    """Return the shifts that leave enough pairs, found by counting the pairs."""
    least = max(1, math.ceil(min_overlap * min(n, m)))
    return [
        j
        for j in range(-n - m, n + m + 1)
        if sum(0 <= i + j < n for i in range(m)) >= least
        and (max_shift is None or abs(j) <= max_shift)
    ]


def mean_at(real: NDArray[np.float64], sim: NDArray[np.float64], j: int) -> tuple[float, int]:
    """Return the mean of ‖real[i + j] − sim[i]‖² over the overlap, and the number of pairs."""
    squares = [
        math.fsum((float(x) - float(y)) ** 2 for x, y in zip(real[i + j], sim[i]))
        for i in range(len(sim))
        if 0 <= i + j < len(real)
    ]
    return math.fsum(squares) / len(squares), len(squares)


def aligned(
    real: NDArray[np.float64],
    sim: NDArray[np.float64],
    max_shift: int | None = None,
    min_overlap: float = 0.5,
) -> float:
    """Return the minimum over j of the mean squares, plus that of the other direction."""
    n, m = len(real), len(sim)
    first = min(mean_at(real, sim, j)[0] for j in admissible(n, m, max_shift, min_overlap))
    second = min(mean_at(sim, real, j)[0] for j in admissible(m, n, max_shift, min_overlap))
    return first + second


def unfolded(real: NDArray[np.float64], sim: NDArray[np.float64]) -> float:
    """Return the mean of both directions' smallest MSE of half a run against a beginning."""
    window = len(sim) // 2
    sides = []
    for slid, held in ((sim, real), (real, sim)):
        places = range(len(slid) - window + 1)
        errors = [slid[p : p + window] - held[:window] for p in places]
        sides.append(min(float((error**2).mean()) for error in errors))
    return sum(sides) / 2.0
