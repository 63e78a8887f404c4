"""DifferentialIk: one step of the joints towards targets in each tick, within all limits.

daqp solves the quadratic program of a step: bounds of each joint, and rows that hold the robot's
capsules apart, by how far they are from each other and how moved joints change that.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from unicon_base import imported
from unicon_base.arrays import Array, Bool, Float64
from unicon_core.models.feet import CROSS
from unicon_core.models.loaded import import_mujoco, index_of
from unicon_core.robots import Robot
from unicon_manipulation.ik.chain import Chain
from unicon_manipulation.ik.tasks import Pose, Settings, Tasks, Weights

# Damping that is always there, squared: keeps the problem definite.
_LEAST = 1e-8
# In [1/s]: of what two capsules are farther apart than wanted, how much they may come nearer in a
# second (Faverjon, Tournassoud, A local based approach for path planning of manipulators with a
# high number of degrees of freedom, ICRA 1987).
_AWAY = 8.0
# In [m], beyond what is wanted, within which pairs are looked at; or what 1 m moves in a tick.
_NEAR = 0.08
# Of the distance that is wanted, which no step goes below.
_GUARD = 0.5
_HALVINGS = 5
# In [1/s], of the way to the default pose.
_HOME = 0.5


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
        rate: Float64,
        period: float,
        settings: Settings,
    ) -> None:
        k = len(chain.moved)
        self._chain, self._settings = chain, settings
        self._limits = np.array(robot.limits(), np.float64)[:, chain.moved]
        self._most = rate * period
        self._least = -self._most
        pose = robot.default_joint_pos.astype(np.float64)
        self._home = pose[chain.moved]
        self._homing = settings.posture**2 * min(_HOME * period, 1.0)
        self._quadratic = Quadratic(k)
        least = settings.posture**2 + _LEAST
        self._tasks = Tasks(chain, weights, least, self._limits, pose)
        self._active, self._next = np.ones(k), np.zeros(k)
        self._waiting: Bool | None = None
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

    def begin(self, joint_pos: Array, which: Bool) -> None:
        """Let some of the moved joints begin where they are, or at their limits.

        Args:
            joint_pos: of the moved joints in [rad], shape (k,).
            which: of them, shape (k,).
        """
        np.copyto(self.pos, np.clip(joint_pos, *self._limits), where=which)

    def activate(self, which: Bool) -> None:
        """Command some of the moved joints, shape (k,); others stand where they are measured."""
        self._active[:] = which
        self._waiting = None if which.all() else ~which

    def __call__(self, joint_pos: Array, targets: Sequence[Pose | None]) -> None:
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


MOST_ROWS = 32
"""More pairs of capsules are not near each other at once; the nearest count."""


class Quadratic:
    """Minimises ½ xᵀ H x + fᵀ x with lower ≤ x ≤ upper and rows x ≥ least.

    daqp (Arnström, Bemporad, Axehill: A dual active-set solver for embedded quadratic programming
    using recursive LDLᵀ updates, IEEE TAC 67(8), 2022) is asked without a warm start, so that what
    it answers depends on the problem alone: a replay is bit-exact.

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
        self._solve: Any = imported("daqp", "block 'reach'", "ik").solve
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


class Apart:
    """Pairs of capsules that are kept apart, p of them.

    MuJoCo computes the distances, in closed form and in one call for all pairs: 2 µs for 74 of
    them, where one call for each pair takes 1 µs.

    Args:
        chain: whose model has the pairs, by `load_apart`.
        near: distance in [m] within which pairs are looked at.
        least: distance in [m] below which pairs are too near.
    """

    def __init__(self, chain: Chain, near: float, least: float) -> None:
        self._mujoco = import_mujoco()
        model, data = chain.loaded.model, chain.data
        self._model, self._data = model, data
        model.pair_margin[:], model.pair_gap[:] = near, 0.0
        pairs = model.npair
        self._row = np.zeros(model.ngeom**2, np.intp)
        self._code = np.array((model.ngeom, 1))
        self._moves = np.zeros((2 * pairs, len(chain.moved)))
        for pair, geoms in enumerate(zip(model.pair_geom1, model.pair_geom2)):
            one, other = map(int, geoms)
            moved = [chain.moved_by(int(model.geom_bodyid[geom])) for geom in (one, other)]
            self._moves[pair] = moved[1].astype(float) - moved[0]
            self._row[self._code @ (one, other)] = pair
            self._row[self._code @ (other, one)] = pair + pairs
        self._moves[pairs:] = -self._moves[:pairs]
        self._least, self._pairs = least, pairs
        self._before, self._now = np.full(pairs, least), np.full(pairs, least)
        root = int(model.body_rootid[model.jnt_bodyid[chain.loaded.joints[0]]])
        self._axes, self._dofs = data.cdof, index_of(chain.dofs.tolist())
        self._centre = data.subtree_com[root]

    def rows(self) -> tuple[Float64, Float64]:
        """Return the distances of points that are near [m], and how moved joints change them.

        Where a body turns about an axis, a point on it moves by the cross product; of the two
        bodies at a point the difference along the normal counts, and none where both move
        together. After `Chain.differentiate`.

        Returns:
            Shapes (c,) and (c, k), the latter in [m/rad].
        """
        self._mujoco.mj_collision(self._model, self._data)
        contact = self._data.contact
        count = len(contact)
        distance = contact.dist
        row = self._row[contact.geom @ self._code]
        self._before[:] = self._least
        if count and distance.min() < self._least:
            np.minimum.at(self._before, row % self._pairs, distance)
        twist = np.empty((count, 6))
        normal = twist[:, 3:]
        normal[:] = contact.frame[:, :3]
        arm = contact.pos - self._centre
        np.matmul((arm @ CROSS).reshape(-1, 3, 3), normal[..., None], out=twist[:, :3, None])
        change = twist @ self._axes[self._dofs].T
        change *= self._moves[row]
        return distance, change

    def too_near(self) -> Bool | None:
        """Return which moved joints bring pairs nearer than they may be, shape (k,), or None.

        A pair that was too near in `rows` may be as near as it was.
        """
        self._mujoco.mj_collision(self._model, self._data)
        contact = self._data.contact
        distance = contact.dist
        if not len(distance) or distance.min() >= self._least:
            return None
        row = self._row[contact.geom @ self._code] % self._pairs
        self._now[:] = self._least
        np.minimum.at(self._now, row, distance)
        wrong = self._now < self._before
        if not wrong.any():
            return None
        return np.asarray(self._moves[: self._pairs][wrong].any(axis=0))
