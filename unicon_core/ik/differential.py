"""DifferentialIk: one step of the joints towards targets in each tick, within all limits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.ik.apart import Apart
from unicon_core.ik.chain import Chain
from unicon_core.ik.quadratic import MOST_ROWS, Quadratic
from unicon_core.ik.settings import Settings, Weights
from unicon_core.ik.tasks import Pose, Tasks
from unicon_core.robots import Robot

Float = NDArray[np.float64]

_LEAST = 1e-8
"""Damping that is always there, squared: keeps the problem definite."""
_AWAY = 8.0
"""In [1/s]: of what two capsules are farther apart than wanted, how much they may come nearer in a
second (Faverjon, Tournassoud, A local based approach for path planning of manipulators with a high
number of degrees of freedom, ICRA 1987)."""
_NEAR = 0.08
"""In [m], beyond what is wanted, within which pairs are looked at; or what 1 m moves in a tick."""
_GUARD = 0.5
"""Of the distance that is wanted, which no step goes below."""
_HALVINGS = 5
_HOME = 0.5
"""In [1/s], of the way to the default pose."""


class DifferentialIk:
    """Moves k joints so that E end effectors come to their targets.

    A step Δq minimises Σ |W (J Δq - e)|² + damping |Δq|² + posture² |Δq - home|², within joint
    limits and the speed, with rows that hold capsules apart. Where rows are linear no more, true
    distances decide: a step after which two capsules were nearer than half of what is wanted is
    halved for the joints that move them, until there is none.

    Args:
        chain: the moved joints and the frames, of a model by `load_apart`.
        robot: says limits and default pose.
        weights: of each end effector, length E.
        rate: largest speed of each moved joint in [rad/s], shape (k,).
        period: of a tick in [s].
        settings: the rest.

    Attributes:
        pos: where the moved joints are commanded, [rad], shape (k,).
        step: of the last tick in [rad], shape (k,).
        error: between each target and what `pos` reaches, [m] and [rad], length E; NaN without a
            target.
        reached: whether each target is reached within the tolerance, length E.
        failures: ticks in which the solver had no answer; the joints kept still.
        halved: steps that the true distances have halved.
    """

    memory = ("pos", "failures", "halved", "_active", "_waiting")

    def __init__(
        self,
        chain: Chain,
        robot: Robot,
        weights: Sequence[Weights],
        rate: Float,
        period: float,
        settings: Settings,
    ) -> None:
        k = len(chain.moved)
        self._chain, self._settings = chain, settings
        self._limits = np.array(
            [
                np.nan_to_num(robot.lower[chain.moved].astype(np.float64), nan=-np.inf),
                np.nan_to_num(robot.upper[chain.moved].astype(np.float64), nan=np.inf),
            ]
        )
        self._most = rate * period
        self._least = -self._most
        pose = robot.default_joint_pos.astype(np.float64)
        self._home = pose[chain.moved]
        self._homing = settings.posture**2 * min(_HOME * period, 1.0)
        self._quadratic = Quadratic(k)
        least = settings.posture**2 + _LEAST
        self._tasks = Tasks(chain, weights, least, self._limits, pose)
        self._active, self._next = np.ones(k), np.zeros(k)
        self._waiting: NDArray[np.bool_] | None = None
        self.pos, self.step = np.zeros(k), self._quadratic.solution
        near, straight = settings.tolerance
        self._tolerances = [
            (near if w.position else math.inf, straight if w.orientation else math.inf)
            for w in weights
        ]
        self.error = [(math.nan, math.nan)] * len(weights)
        self.reached = [False] * len(weights)
        self.failures = self.halved = 0
        self._apart: Apart | None = None
        if settings.apart and chain.loaded.model.npair:
            near = settings.apart + max(_NEAR, float(self._most.max()))
            self._apart = Apart(chain, near, _GUARD * settings.apart)
        self._approach = -math.expm1(-_AWAY * period)

    def begin(self, joint_pos: NDArray[Any], which: NDArray[np.bool_]) -> None:
        """Let some of the moved joints begin where they are, or at their limits.

        Args:
            joint_pos: of the moved joints in [rad], shape (k,).
            which: of them, shape (k,).
        """
        np.copyto(self.pos, np.clip(joint_pos, *self._limits), where=which)

    def activate(self, which: NDArray[np.bool_]) -> None:
        """Command some of the moved joints, shape (k,); others stand where they are measured."""
        self._active[:] = which
        self._waiting = None if which.all() else ~which

    def __call__(self, joint_pos: NDArray[Any], targets: Sequence[Pose | None]) -> None:
        """Move `pos` on by one step.

        Args:
            joint_pos: measured, in the robot's order in [rad], shape (n,).
            targets: of each end effector, None where there is none.
        """
        chain, problem, pos, spare = self._chain, self._quadratic, self.pos, self._next
        if self._waiting is not None:
            np.copyto(pos, joint_pos[chain.moved], where=self._waiting)
        chain.put(joint_pos, pos)
        chain.differentiate()
        self._tasks(targets, problem.square, problem.slope)
        np.subtract(pos, self._home, out=spare)
        spare *= self._homing
        problem.slope += spare
        bounds = problem.bounds
        np.subtract(self._limits, pos, out=bounds)
        np.maximum(bounds, self._least, out=bounds)
        np.minimum(bounds, self._most, out=bounds)
        if self._waiting is not None:
            problem.slope *= self._active
            bounds *= self._active
        rows = 0 if self._apart is None else self._keep_apart(self._apart)
        if not problem.solve(rows):
            self.failures += 1
        np.add(pos, self.step, out=spare)
        chain.move(spare)
        if self._apart is not None:
            self._hold_back(self._apart)
        pos[:] = spare
        for i, target in enumerate(targets):
            self._tell(i, target)

    def _keep_apart(self, apart: Apart) -> int:
        """Write the rows that hold capsules apart; return how many there are.

        What is nearer than wanted need not go away, but comes no nearer: no step at all is within
        the rows always, and within the bounds.
        """
        distance, change = apart.rows()
        if len(distance) > MOST_ROWS:
            nearest = np.argpartition(distance, MOST_ROWS)[:MOST_ROWS]
            distance, change = distance[nearest], change[nearest]
        count, problem = len(distance), self._quadratic
        if count:
            np.multiply(change, self._active, out=problem.rows[:count])
            least = problem.least[:count]
            np.subtract(self._settings.apart, distance, out=least)
            np.minimum(least, 0.0, out=least)
            least *= self._approach
        return count

    def _hold_back(self, apart: Apart) -> None:
        """Halve the step, and where it would lead, for joints that bring capsules too near."""
        for left in range(_HALVINGS, -1, -1):
            near = apart.too_near()
            if near is None:
                return
            self.halved += 1
            self.step[near] *= 0.5 if left > 1 else 0.0
            if not left:
                self.step[:] = 0.0
            np.add(self.pos, self.step, out=self._next)
            self._chain.move(self._next)

    def _tell(self, effector: int, target: Pose | None) -> None:
        """Write `error` and `reached` of an end effector, whose chain stands where it shall."""
        if target is None:
            self.error[effector], self.reached[effector] = (math.nan, math.nan), False
            return
        position, turn = self._tasks.lack(effector, target)
        far, wide = math.hypot(*position), math.hypot(*turn)
        near, straight = self._tolerances[effector]
        self.error[effector] = far, wide
        self.reached[effector] = far <= near and wide <= straight
