"""Quadratic programs of inverse kinematics: bounds of each joint, and rows; solved by daqp."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import MissingDependencyError

Float = NDArray[np.float64]

MOST_ROWS = 32
"""More pairs of capsules are not near each other at once; the nearest count."""


class Quadratic:
    """Minimises ½ xᵀ H x + fᵀ x with lower ≤ x ≤ upper and rows x ≥ least.

    daqp (Arnström, Bemporad, Axehill: A dual active-set solver for embedded quadratic programming
    using recursive LDLᵀ updates, IEEE TAC 67(8), 2022) is asked without a warm start, so that what
    it answers depends on the problem alone: a replay is the same to the bit.

    Args:
        size: of x, k.

    Attributes:
        square: H, positive definite, shape (k, k).
        slope: f, shape (k,).
        bounds: lower and upper ones, shape (2, k); 0 is within.
        rows: shape (MOST_ROWS, k).
        least: shape (MOST_ROWS,).
        solution: x after `solve`, shape (k,).

    Raises:
        MissingDependencyError: daqp is not installed.
    """

    def __init__(self, size: int) -> None:
        try:
            import daqp
        except ModuleNotFoundError as error:
            raise MissingDependencyError(
                "block 'reach'", "daqp", "pip install 'unicon_ros[ik]'"
            ) from error
        self._solve: Any = daqp.solve
        most = size + MOST_ROWS
        self.square, self.slope = np.zeros((size, size)), np.zeros(size)
        self.rows = np.zeros((MOST_ROWS, size))
        self._sides = np.zeros((2, most))
        self._below, self._above = self._sides
        self._above[:] = 1e30
        self.bounds, self.least = self._sides[:, :size], self._below[size:]
        self._kinds = np.zeros(most, np.intc)
        self.solution = np.zeros(size)
        self._size = size

    def solve(self, rows: int = 0) -> bool:
        """Write the solution; False, and 0 everywhere, where there is none.

        Args:
            rows: how many of them count.
        """
        end = self._size + rows
        found, _, status, _ = self._solve(
            self.square,
            self.slope,
            self.rows[:rows],
            self._above[:end],
            self._below[:end],
            self._kinds[:end],
        )
        # A solution of daqp is within 1e-6; a NaN passes no comparison.
        np.maximum(found, self.bounds[0], out=self.solution)
        np.minimum(self.solution, self.bounds[1], out=self.solution)
        total = self.solution.sum()
        if status > 0 and total - total == 0.0:
            return True
        self.solution[:] = 0.0
        return False
