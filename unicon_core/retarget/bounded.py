"""Gauss-Newton within bounds: nonlinear least squares of a few variables, warm started.

    minimise |r(q)|²  with  lower ≤ q ≤ upper

Each step solves the normal equations (JᵀJ + λ diag) dq = -Jᵀr of the variables that are free, those
at a bound against which the gradient pushes them being held (Bertsekas, Projected Newton Methods,
SIAM J. Control Optim. 20(2), 1982), with Marquardt's damping λ where a step does not help.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Residual = Callable[[Float], tuple[Float, Float]]

MOST = 20
"""Looks at a place. A hand that is followed takes 1 to 3, one from far away 6 to 12; where so many
do not do, the next call goes on."""
SMALL = 2e-3
"""A step in [rad] that is taken without a look at where it leads: the error behind it is about its
square where the goal can be reached, and the next call goes on from there. A step that damping has
made small is none of these."""
LEAST, FIRST = 1e-9, 0.01
"""Of the damping: below it there is none, and where the first step does not help."""
FLOOR = 1e-9
"""Of the diagonal in [m²]: a joint that moves nothing has 0; one of a finger 1e-4 to 1e-2."""
INSIDE = 0.02
"""Share of its range by which a joint is started inside its bounds. A finger may be straight at
one: what it misses then lies along it, no gradient bends it, and it would stay so for ever."""


class Bounded:
    """Solves one problem again and again.

    Args:
        residual: returns r(q), shape (m,), and its Jacobian, shape (m, n).
        lower: smallest allowed value, shape (n,).
        upper: largest.

    Attributes:
        looks: that the last `solve` took.
    """

    def __init__(self, residual: Residual, lower: Float, upper: Float) -> None:
        self._residual, self._lower, self._upper = residual, lower, upper
        inside = INSIDE * (upper - lower)
        self._from, self._to = lower + inside, upper - inside
        count = len(lower)
        self._normal, self._gradient = np.zeros((count, count)), np.zeros(count)
        self._system = np.zeros((count, count))
        self._diagonal = self._system.reshape(-1)[:: count + 1]
        self.looks = 0

    def solve(self, q: Float) -> float:
        """Improve `q` in place, from within its bounds; return |r(q)|², or nearly so."""
        lower, upper = self._lower, self._upper
        system, diagonal = self._system, self._diagonal
        np.maximum(q, self._from, out=q)
        np.minimum(q, self._to, out=q)
        cost, damping, moved = self._linearise(q), LEAST, True
        for self.looks in range(1, MOST):
            if moved:
                wanted = self._gradient.copy()
                system[...] = self._normal
                if self.looks > 1:  # the first is inside
                    held = ((q <= lower) & (wanted > 0.0)) | ((q >= upper) & (wanted < 0.0))
                    if held.any():
                        wanted[held] = system[held] = system[:, held] = 0.0
                diagonal += FLOOR
            if damping > LEAST:
                diagonal *= 1.0 + damping
            trial = q - np.linalg.solve(system, wanted)
            np.maximum(trial, lower, out=trial)
            np.minimum(trial, upper, out=trial)
            moves = trial - q
            step = max(float(moves.max()), -float(moves.min()))
            if step < (SMALL if moved else SMALL**2):
                q[...] = trial
                break
            found = self._linearise(trial)
            moved = found <= cost
            if moved:
                q[...], cost = trial, found
                damping = max(damping * 0.1, LEAST)
            else:
                damping = max(damping * 10.0, FIRST)
        return cost

    def _linearise(self, q: Float) -> float:
        """Take residual and Jacobian at `q` into the normal equations; return |r|²."""
        residual, jacobian = self._residual(q)
        np.matmul(jacobian.T, jacobian, out=self._normal)
        np.matmul(jacobian.T, residual, out=self._gradient)
        return float(residual @ residual)
