"""Tasks: what end effectors lack to their targets, as the cost of a quadratic program.

With what its builder says: weights, distances and tolerances. Targets are read of states,
brought to the present, and refused where they are none.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, TypeAlias

import numpy as np

from unicon_base import TextSink
from unicon_base.arrays import Array, Float64
from unicon_base.schema.marks import Within
from unicon_core.models.frames import turn_between, turned_by
from unicon_manipulation.ik.chain import Chain

Pose: TypeAlias = tuple[Sequence[float], Sequence[float]]
"""Position in [m] and unit quaternion wxyz, in the base frame."""

FARTHEST, WIDEST = 0.15, 0.8
"""Errors in [m] and [rad] beyond which no farther step is asked for: what is linear ends there."""
# Of the squared weighted error, as damping (Sugihara, Solvability-unconcerned inverse kinematics by
# the Levenberg-Marquardt method, IEEE T-RO 27(5), 2011): with a target 40 mm out of reach that
# shakes by 1 mm, the joints of a G1's arm move at 0.25 rad/s and not at 2.8.
_OF_ERROR = 1.0
# Damping at a singularity, and the share of the usual manipulability from which it grows (Nakamura,
# Hanafusa, Inverse kinematic solutions with singularity robustness for robot manipulator control,
# 1986): the stretched arm then moves a quarter less.
_SINGULAR, _POOR = 0.1, 0.3
_SAMPLES = 200


class Tasks:
    """The cost Σ |W (J Δq - e)|² + damping |Δq|² of E end effectors and k joints.

    Args:
        chain: the joints and the frames.
        weights: of each end effector, length E.
        damping: that is always there, squared.
        limits: lowest and highest position of each joint in [rad], shape (2, k).
        pose: of all joints in the robot's order in [rad], where others stand to measure what is
            usual, shape (n,).
    """

    def __init__(
        self,
        chain: Chain,
        weights: Sequence[Weights],
        damping: float,
        limits: Float64,
        pose: Float64,
    ) -> None:
        self._chain = chain
        self._plain = [(w.position, w.orientation) for w in weights]
        count, k = len(weights), len(chain.moved)
        self._weights = np.array([[w.position] * 3 + [w.orientation] * 3 for w in weights])
        self._columns = self._weights[..., None]
        self._task, self._wanted = np.zeros((count, 6, k)), np.zeros((count, 6))
        self._rows, self._whole = self._task.reshape(-1, k), self._wanted.reshape(-1)
        self._turned = self._rows.T
        # The damping of each joint is that of the end effectors that it carries, and the least.
        self._carried = np.vstack([chain.carries.astype(np.float64), np.ones(k)])
        self._damping, self._each = np.zeros(k), np.zeros(count + 1)
        self._each[-1] = damping
        self._gram, self._identity = np.zeros((count, 6, 6)), np.eye(6)
        self._unused = np.array([np.diag((row == 0.0).astype(float)) for row in self._weights])
        self._some_unused = bool(self._unused.any())
        self._narrow = [
            (i, np.flatnonzero(chain.carries[i]))
            for i, row in enumerate(self._weights)
            if (row > 0.0).sum() > chain.carries[i].sum()
        ]
        self._usual = self._usual_of(limits, pose)

    def lack(self, effector: int, target: Pose) -> tuple[list[float], Sequence[float]]:
        """Return what an end effector lacks to its target, in [m] and [rad], axes of the base."""
        place, quat = self._chain.frame(effector)
        position, wanted = target
        return [a - b for a, b in zip(position, place)], turn_between(quat, wanted)

    def __call__(self, targets: Sequence[Pose | None], square: Float64, slope: Float64) -> None:
        """Write the cost ½ Δqᵀ H Δq + fᵀ Δq, of a chain that is put and differentiated.

        Args:
            targets: of each end effector, None where there is none.
            square: H, shape (k, k).
            slope: f, shape (k,).
        """
        wanted, task, each = self._wanted, self._task, self._each
        np.multiply(self._chain.jacobian, self._columns, out=task)
        for i, target in enumerate(targets):
            if target is None:
                wanted[i] = task[i] = each[i] = 0.0
                continue
            position, turn = self.lack(i, target)
            near, straight = self._plain[i]
            far, wide = math.hypot(*position), math.hypot(*turn)
            each[i] = _OF_ERROR * (
                (near * min(far, FARTHEST)) ** 2 + (straight * min(wide, WIDEST)) ** 2
            )
            near *= FARTHEST / far if far > FARTHEST else 1.0
            straight *= WIDEST / wide if wide > WIDEST else 1.0
            x, y, z = position
            u, v, w = turn
            wanted[i] = near * x, near * y, near * z, straight * u, straight * v, straight * w
        for i, determinant in enumerate(self._determinants(task).tolist()):
            share = math.sqrt(max(determinant, 0.0)) / self._usual[i]
            if share < 1.0 and targets[i] is not None:
                each[i] += (_SINGULAR * (1.0 - share)) ** 2
        np.matmul(each, self._carried, out=self._damping)
        np.matmul(self._turned, self._rows, out=square)
        square.reshape(-1)[:: len(slope) + 1] += self._damping
        np.matmul(self._whole, self._rows, out=slope)
        np.negative(slope, out=slope)

    def _determinants(self, task: Float64) -> Float64:
        """Return det(J Jᵀ) of each end effector by its weighted rows, shape (E,).

        Of one with fewer joints than rows it is det(Jᵀ J). Its root is the manipulability
        (Yoshikawa, Manipulability of robotic mechanisms, IJRR 4(2), 1985).
        """
        square = self._gram
        np.matmul(task, task.transpose(0, 2, 1), out=square)
        if self._some_unused:
            square += self._unused
        for i, joints in self._narrow:
            columns = task[i][:, joints]
            square[i] = self._identity
            square[i, : len(joints), : len(joints)] = columns.T @ columns
        found: Float64 = np.linalg.det(square)
        return found

    def _usual_of(self, limits: Float64, pose: Float64) -> list[float]:
        """Return the manipulability below which each end effector is near a singularity.

        A share of the median over random poses: a scale of each arm's own.
        """
        chain, random = self._chain, np.random.default_rng(0)
        lower, upper = np.clip(limits, -math.pi, math.pi)
        found = np.zeros((_SAMPLES, len(self._plain)))
        for row in found:
            chain.put(pose, random.uniform(lower, upper))
            chain.differentiate()
            row[:] = self._determinants(chain.jacobian * self._columns)
        usual = np.sqrt(np.maximum(np.median(found, axis=0), 0.0))
        return [max(_POOR * each, 1e-12) for each in usual.tolist()]


APART = 0.02
"""Between capsules in [m]: targets of arms that a walking robot swings are off by 4 to 12 mm."""


Weight = Annotated[float, Within(0.0, 100.0)]


@dataclass(frozen=True)
class Weights:
    """How much an end effector's errors count against those of others."""

    position: Weight = 1.0
    """Of 1 m; 0 leaves it free."""
    orientation: Weight = 0.3
    """Of 1 rad: a hand that is 0.3 m wide moves its edge as far. 0 leaves it free."""


@dataclass(frozen=True)
class Settings:
    """What is the same in every tick."""

    posture: float = 0.02
    """Weight of 1 rad to the default pose, against an end effector's 1 m."""
    apart: float = APART
    """Distance in [m] that capsules keep; 0 lets them touch."""
    tolerance: tuple[float, float] = (0.005, 0.05)
    """Error in [m] and [rad] within which a target is reached."""


LONGEST = 0.3
"""In [s], over which a target's velocity is believed: a hand turns round in as much."""
# By which the length of a quaternion may be off: float32 and averages of it are within 1e-3.
_UNIT = 0.05


@dataclass(eq=False)
class Target:
    """The target of one end effector.

    Attributes:
        effector: its name, for what is told.
        pose: position in [m] and quaternion wxyz, shape (7,).
        velocity: in [m/s] and [rad/s], shape (6,).
        stamp_ns: when it was true, 0 for now, shape ().
        turns: whether its orientation counts.
        look_ahead: in [s], by which it is brought on.
        tell: takes one line, once for each time that it is refused.
    """

    effector: str
    pose: Array
    velocity: Array
    stamp_ns: Array
    turns: bool
    look_ahead: float
    tell: TextSink
    _told: bool = field(default=False, init=False)
    memory = ("_told",)

    def __call__(self, now_ns: int) -> Pose | None:
        """Return the target as it will be, None where there is none.

        Args:
            now_ns: time of the robot's data.
        """
        x, y, z, *quat = self.pose.tolist()
        if not self.turns:
            quat = [1.0, 0.0, 0.0, 0.0]
        if math.isnan(x + y + z) or any(map(math.isnan, quat)):
            self._told = False
            return None
        length = math.sqrt(sum(each * each for each in quat))
        if not (math.isfinite(x + y + z) and abs(length - 1.0) <= _UNIT):
            if not self._told:
                self._told = True
                finite = math.isfinite(x) and math.isfinite(y) and math.isfinite(z)
                what = f"quaternion of length {length:.3g}" if finite else f"position {[x, y, z]}"
                self.tell(
                    f"reach: {self.effector}_target has a {what}, which counts as no target; "
                    "write finite [m] and a unit quaternion, w first, or NaN for none"
                )
            return None
        self._told = False
        quat = [each / length for each in quat]
        stamp = int(self.stamp_ns)
        age = 1e-9 * (now_ns - stamp) if stamp else 0.0
        ahead = min(max(self.look_ahead + max(age, 0.0), 0.0), LONGEST)
        velocity = self.velocity.tolist()
        if not ahead or not all(map(math.isfinite, velocity)) or not any(velocity):
            return (x, y, z), quat
        vx, vy, vz, *turning = velocity
        place = (x + ahead * vx, y + ahead * vy, z + ahead * vz)
        return place, turned_by(quat, turning, ahead)
