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
from unicon_core.ik.turns import turn_between
from unicon_core.robots import Robot

__all__ = ["DifferentialIk", "Pose"]

Float = NDArray[np.float64]
Pose = tuple[Sequence[float], Sequence[float]]
"""Position in [m] and unit quaternion wxyz, in the base frame."""

FARTHEST, WIDEST = 0.15, 0.8
"""Errors in [m] and [rad] beyond which no farther step is asked for: what is linear ends there."""
_OF_ERROR = 0.3
"""Of the squared weighted error, as damping (Sugihara: Solvability-unconcerned inverse kinematics
by the Levenberg-Marquardt method, IEEE T-RO 27(5), 2011): a target out of reach moves nothing."""
_LEAST = 1e-4
"""Damping that is always there, squared: keeps the problem definite."""
_SINGULAR, _POOR = 0.03, 0.3
"""Damping at a singularity, squared, and the share of the usual manipulability from which it grows
(Nakamura, Hanafusa: Inverse kinematic solutions with singularity robustness, 1986)."""
_AWAY = 8.0
"""In [1/s]: the share of what two capsules are farther apart than wanted that they may come nearer
in a second (Faverjon, Tournassoud: A local based approach for path planning, ICRA 1987)."""
_NEAR = 0.08
"""In [m], beyond what is wanted, within which pairs are looked at; or what 1 m moves in a tick."""
_HALVINGS = 6
_HOME = 0.5
"""In [1/s], of the way to the default pose."""
_SAMPLES = 200


class DifferentialIk:
    """Moves k joints so that E end effectors come to their targets.

    A step Δq minimises Σ |W (J Δq - e)|² + damping |Δq|² + posture² |Δq - home|², within joint limits
    and the speed, with rows that hold capsules apart. What is linear about the rows ends with the
    step: after it the true distances are looked at, and where two capsules would be nearer than half
    of what is wanted, the step of the joints that move them is halved, until there is none.

    Args:
        chain: the moved joints and the frames.
        robot: says limits and default pose.
        weights: of each end effector, length E.
        rate: largest speed of each moved joint in [rad/s], shape (k,).
        period: of a tick in [s].
        settings: the rest.

    Attributes:
        pos: where the moved joints are commanded, [rad], shape (k,).
        step: of the last tick in [rad], shape (k,).
        error: between each target and what `pos` reaches, [m] and [rad], shape (E, 2); NaN without
            a target.
        reached: whether each target is reached within the tolerance, length E.
        failures: ticks in which the solver had no answer; the joints kept still.
        apart: the pairs, or None.
    """

    def __init__(
        self,
        chain: Chain,
        robot: Robot,
        weights: Sequence[Weights],
        rate: Float,
        period: float,
        settings: Settings,
    ) -> None:
        k, count = len(chain.moved), len(weights)
        self._chain, self._settings = chain, settings
        self._lower = np.nan_to_num(robot.lower[chain.moved].astype(np.float64), nan=-np.inf)
        self._upper = np.nan_to_num(robot.upper[chain.moved].astype(np.float64), nan=np.inf)
        self._most = rate * period
        self._least = -self._most
        self._home = robot.default_joint_pos[chain.moved].astype(np.float64)
        self._homing = settings.posture**2 * min(_HOME * period, 1.0)
        self._quadratic = Quadratic(k)
        self._diagonal = self._quadratic.square.reshape(-1)[:: k + 1]
        self._weights = np.array([[w.position] * 3 + [w.orientation] * 3 for w in weights])
        self._task, self._wanted = np.zeros((count, 6, k)), np.zeros((count, 6))
        self._damping = np.zeros(k)
        self._carries = chain.carries.astype(np.float64)
        self.pos, self.step, self._next = np.zeros(k), np.zeros(k), np.zeros(k)
        self.error = np.full((count, 2), np.nan)
        near, straight = settings.tolerance
        self._bounds = [
            (near if w.position else math.inf, straight if w.orientation else math.inf)
            for w in weights
        ]
        self.reached = [False] * count
        self.failures = 0
        self.apart: Apart | None = None
        if settings.apart and chain.loaded.model.npair:
            self.apart = Apart(chain, settings.apart + max(_NEAR, float(self._most.max())))
        self._nearest = math.exp(-_AWAY * period)
        self._gram, self._identity = np.zeros((count, 6, 6)), np.eye(6)
        self._unused = np.array([np.diag((row == 0.0).astype(float)) for row in self._weights])
        self._narrow = [
            (i, np.flatnonzero(chain.carries[i]))
            for i, row in enumerate(self._weights)
            if (row > 0.0).sum() > chain.carries[i].sum()
        ]
        self._usual = self._usual_of(robot)

    def begin(self, joint_pos: NDArray[Any], which: NDArray[np.bool_]) -> None:
        """Let some of the moved joints begin where they are, or at their limits.

        Args:
            joint_pos: of the moved joints in [rad], shape (k,).
            which: of them, shape (k,).
        """
        np.copyto(self.pos, np.clip(joint_pos, self._lower, self._upper), where=which)

    def __call__(
        self, joint_pos: NDArray[Any], targets: Sequence[Pose | None], active: Float
    ) -> None:
        """Move `pos` on by one step.

        Args:
            joint_pos: measured, in the robot's order in [rad], shape (n,).
            targets: of each end effector, None where there is none.
            active: 1 for each moved joint that is commanded, else 0: it stands where it is measured,
                shape (k,).
        """
        chain, problem = self._chain, self._quadratic
        own = joint_pos[chain.moved]
        np.copyto(self.pos, own, where=active == 0.0)
        chain.put(joint_pos, self.pos)
        chain.differentiate()
        self._assemble(targets, active)
        np.subtract(self._lower, self.pos, out=self._next)
        np.clip(self._next, self._least, self._most, out=problem.lower)
        np.subtract(self._upper, self.pos, out=self._next)
        np.clip(self._next, self._least, self._most, out=problem.upper)
        problem.lower *= active
        problem.upper *= active
        rows = self._keep_apart(active) if self.apart is not None else 0
        if not problem.solve(rows):
            self.failures += 1
        self.step[:] = problem.solution
        self._take_step()
        self._tell(targets)

    def _assemble(self, targets: Sequence[Pose | None], active: Float) -> None:
        """Write H and f of the quadratic program."""
        chain, problem, wanted = self._chain, self._quadratic, self._wanted
        np.multiply(chain.jacobian, self._weights[..., None], out=self._task)
        for i, target in enumerate(targets):
            if target is None:
                wanted[i] = self._task[i] = 0.0
                continue
            position, turn = self._errors(i, target)
            far, wide = math.hypot(*position), math.hypot(*turn)
            most, widest = min(1.0, FARTHEST / max(far, 1e-9)), min(1.0, WIDEST / max(wide, 1e-9))
            wanted[i] = [most * x for x in position] + [widest * x for x in turn]
        wanted *= self._weights
        task = self._task.reshape(-1, len(self.pos))
        np.matmul(task.T, task, out=problem.square)
        np.matmul(task.T, wanted.reshape(-1), out=problem.slope)
        damping = (wanted * wanted).sum(axis=1)
        damping *= _OF_ERROR
        damping += self._poor(self._task)
        np.matmul(damping, self._carries, out=self._damping)
        self._damping += self._settings.posture**2 + _LEAST**2
        self._diagonal += self._damping
        np.subtract(self._home, self.pos, out=self._next)
        self._next *= self._homing
        self._next *= active
        problem.slope += self._next
        np.negative(problem.slope, out=problem.slope)

    def _errors(self, effector: int, target: Pose) -> tuple[list[float], Sequence[float]]:
        """Return what an end effector lacks to its target, in [m] and [rad], axes of the base."""
        place, quat = self._chain.frame(effector)
        position, wanted = target
        return [a - b for a, b in zip(position, place)], turn_between(quat, wanted)

    def _poor(self, task: Float) -> Float:
        """Return the damping near singularities of each end effector, squared, shape (E,)."""
        found = self._measure(task)
        found /= self._usual
        np.subtract(1.0, found, out=found)
        np.maximum(found, 0.0, out=found)
        found *= found
        found *= _SINGULAR**2
        return found

    def _measure(self, task: Float) -> Float:
        """Return the manipulability √det(J Jᵀ) of each end effector by weighted rows, shape (E,).

        Of one with fewer joints than rows it is √det(Jᵀ J) (Yoshikawa, IJRR 4(2), 1985).
        """
        square = self._gram
        np.matmul(task, task.transpose(0, 2, 1), out=square)
        square += self._unused
        for i, joints in self._narrow:
            columns = task[i][:, joints]
            square[i] = self._identity
            square[i, : len(joints), : len(joints)] = columns.T @ columns
        return np.sqrt(np.maximum(np.linalg.det(square), 0.0))

    def _usual_of(self, robot: Robot) -> Float:
        """Return the median manipulability over random poses, shape (E,)."""
        chain, random = self._chain, np.random.default_rng(0)
        lower, upper = np.maximum(self._lower, -math.pi), np.minimum(self._upper, math.pi)
        default = robot.default_joint_pos.astype(np.float64)
        found = np.zeros((_SAMPLES, len(self._weights)))
        for row in found:
            chain.put(default, random.uniform(lower, upper))
            chain.differentiate()
            row[:] = self._measure(chain.jacobian * self._weights[..., None])
        return np.maximum(np.median(found, axis=0) * _POOR, 1e-12)

    def _keep_apart(self, active: Float) -> int:
        """Write the rows that hold capsules apart; return how many there are."""
        apart, problem = self.apart, self._quadratic
        assert apart is not None
        if not apart.look():
            return 0
        distance, change = apart.rows()
        if len(distance) > MOST_ROWS:
            nearest = np.argpartition(distance, MOST_ROWS)[:MOST_ROWS]
            distance, change = distance[nearest], change[nearest]
        count = len(distance)
        np.multiply(change, active, out=problem.rows[:count])
        # What is nearer than wanted does not come nearer still; 0 is always a solution.
        np.subtract(distance, self._settings.apart, out=problem.least[:count])
        np.maximum(problem.least[:count], 0.0, out=problem.least[:count])
        problem.least[:count] *= self._nearest - 1.0
        return count

    def _take_step(self) -> None:
        """Move `pos` by the step, or by as much of it as keeps all capsules apart."""
        chain, apart, step = self._chain, self.apart, self.step
        np.add(self.pos, step, out=self._next)
        chain.move(self._next)
        if apart is not None:
            before = np.minimum(apart.distance, 0.5 * self._settings.apart)
            for left in range(_HALVINGS, -1, -1):
                apart.look()
                wrong = apart.distance < before
                if not wrong.any():
                    break
                step *= np.where(apart.joints(wrong), 0.5 if left > 1 else 0.0, 1.0)
                if not left:
                    step[:] = 0.0
                np.add(self.pos, step, out=self._next)
                chain.move(self._next)
        self.pos[:] = self._next

    def _tell(self, targets: Sequence[Pose | None]) -> None:
        """Write `error` and `reached`."""
        for i, target in enumerate(targets):
            if target is None:
                self.error[i], self.reached[i] = np.nan, False
                continue
            position, turn = self._errors(i, target)
            far, wide = math.hypot(*position), math.hypot(*turn)
            self.error[i] = far, wide
            near, straight = self._bounds[i]
            self.reached[i] = far <= near and wide <= straight
