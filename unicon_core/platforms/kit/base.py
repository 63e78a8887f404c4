"""The base's states, from its pose and twist in the world or from an IMU mounted anyhow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from unicon_base.arrays import Array, Float64
from unicon_core.robots import Robot

IMU_STATES = ("base_quat", "base_ang_vel", "base_lin_acc")
"""What an IMU tells: orientation, angular velocity, specific force."""


class WorldPose(NamedTuple):
    """Where the bases of N robots are and how they move, each in a world of its own."""

    position: Float64
    """Of the base frame's origin in [m], shape (N, 3)."""
    quat: Float64
    """Base to world, unit quaternion wxyz, shape (N, 4)."""
    lin_vel: Float64
    """Of the origin, along the world's axes in [m/s], shape (N, 3)."""
    ang_vel: Float64
    """Along the world's axes in [rad/s], shape (N, 3)."""


def _products(*terms: str) -> Float64:
    """Return what makes sums of products of two vectors: signed pairs of indices, one row each."""
    size = 1 + max(int(digit) for term in terms for digit in term if digit.isdigit())
    matrix = np.zeros((size * size, len(terms)))
    for column, term in enumerate(terms):
        for sign, i, j in zip(*[iter(term)] * 3):
            matrix[size * int(i) + int(j), column] += 1.0 if sign == "+" else -1.0
    return matrix


# Of a quaternion's elements, for the nine of its matrix, row by row.
_ROTATION = _products(
    *("+00+11-22-33", "+12+12-03-03", "+13+13+02+02"),
    *("+12+12+03+03", "+00-11+22-33", "+23+23-01-01"),
    *("+13+13-02-02", "+23+23+01+01", "+00-11-22+33"),
)

_CROSS = _products("+12-21", "+20-02", "+01-10")


def rotation(quat: Array) -> Float64:
    """Return the rotation matrices of unit quaternions wxyz, shapes (..., 4) and (..., 3, 3)."""
    q = np.asarray(quat, np.float64)
    pairs = (q[..., :, None] * q[..., None, :]).reshape(*q.shape[:-1], 16)
    return (pairs @ _ROTATION).reshape(*q.shape[:-1], 3, 3)


def rotation_of(w: float, x: float, y: float, z: float, norm: float) -> tuple[float, ...]:
    """Return the rotation of a quaternion wxyz as nine numbers, row by row, for ticks: 1 µs.

    Args:
        w, x, y, z: of any length.
        norm: square of that length.
    """
    s = 2.0 / norm
    return (
        1.0 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y),
        s * (x * y + w * z), 1.0 - s * (x * x + z * z), s * (y * z - w * x),
        s * (x * z - w * y), s * (y * z + w * x), 1.0 - s * (x * x + y * y),
    )  # fmt: skip


def cross(left: Float64, right: Float64) -> Float64:
    """Return left × right, shapes (..., 3); `np.cross` takes several times as long for few."""
    pairs = left[..., :, None] * right[..., None, :]
    return pairs.reshape(*left.shape[:-1], 9) @ _CROSS


def quat_of_rpy(rpy: Array) -> Float64:
    """Return the unit quaternion wxyz of roll, pitch, yaw in [rad], shapes (..., 3) and (..., 4).

    q = q_z(yaw) q_y(pitch) q_x(roll): turned about the fixed x, y and z axes, one after the other.
    """
    half = 0.5 * np.asarray(rpy, np.float64)
    (cr, cp, cy), (sr, sp, sy) = np.cos(half).T, np.sin(half).T
    parts = (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )
    return np.array(parts).T


def rpy_of_quat(quat: Array) -> Float64:
    """Return roll, pitch, yaw in [rad] of a unit quaternion wxyz, shape (3,); see `quat_of_rpy`."""
    matrix = rotation(quat)
    return np.array(
        (
            np.arctan2(matrix[2, 1], matrix[2, 2]),
            np.arcsin(np.clip(-matrix[2, 0], -1.0, 1.0)),
            np.arctan2(matrix[1, 0], matrix[0, 0]),
        )
    )


class Mounting:
    """How a sensor sits on the base: turns its readings into the base frame.

        mounting = Mounting.of(robot)                       # robot.imu of the robot file
        mounting.turn(readings, {name: states[name] for name in IMU_STATES})

    An accelerometer keeps its place: only its axes are turned, its lever arm stays in the reading.

    Args:
        quat: sensor to base, unit quaternion wxyz, shape (4,).

    Attributes:
        turned: whether there is anything to turn; if not, readings pass as they are.
    """

    def __init__(self, quat: Array) -> None:
        w, x, y, z = map(float, quat)
        self.turned = not np.allclose(np.abs(quat), (1.0, 0.0, 0.0, 0.0), atol=1e-9)
        self._base_from_sensor = rotation(quat)
        # q ↦ q · conj(quat), as a matrix
        self._right = np.array(((w, x, y, z), (-x, w, -z, y), (-y, z, w, -x), (-z, -y, x, w)))

    @classmethod
    def of(cls, robot: Robot) -> Mounting:
        """Return how a robot's IMU is mounted; where its file does not say, as the base."""
        known = robot.imu is not None and np.isfinite(robot.imu.quat).all()
        return cls(robot.imu.quat if known and robot.imu else np.array((1.0, 0.0, 0.0, 0.0)))

    def vector(self, reading: Array) -> Array:
        """Return a rate or an acceleration of the sensor's frame in the base frame, shape (3,)."""
        return self._base_from_sensor @ reading if self.turned else reading

    def quat(self, reading: Array) -> Array:
        """Return the orientation base to world of one sensor to world, wxyz, shape (4,)."""
        return self._right @ reading if self.turned else reading

    def turn(self, readings: Mapping[str, Array], into: Mapping[str, Array]) -> None:
        """Write the readings of an IMU, by name as of `IMU_STATES`, as one on the base has them.

        Args:
            readings: of the sensor; they may be the arrays that are written.
            into: takes the base's.
        """
        into["base_quat"][...] = self.quat(readings["base_quat"])
        for name in ("base_ang_vel", "base_lin_acc"):
            into[name][...] = self.vector(readings[name])


class BaseStates:
    """Writes the base's states, those that are there.

    `base_lin_acc` is what an accelerometer at the IMU's place reads along the base's axes: the
    specific force R(q)ᵀ (a - g), by the change of that point's velocity over one physics step.

    Args:
        views: state arrays by name, of N robots, shape (N, ...).
        robot: says where the IMU is.
        step: physics step in [s].
        gravity: in the world in [m/s²], shape (3,).
    """

    def __init__(
        self, views: Mapping[str, Array], robot: Robot, step: float, gravity: Float64
    ) -> None:
        self._views = views
        self._step = step
        self._gravity = gravity
        self._down = gravity / max(float(np.linalg.norm(gravity)), 1e-9)
        self._arm = np.zeros(3) if robot.imu is None else np.nan_to_num(robot.imu.position)
        at = {"base_ang_vel": 0, "base_lin_acc": 1, "projected_gravity": 2, "base_lin_vel": 3}
        self._turned = [(views[name], i) for name, i in at.items() if name in views]
        self._copied = [
            (views[name], i) for i, name in enumerate(("base_pos_w", "base_quat")) if name in views
        ]
        count = max(map(len, views.values()), default=0)
        self._count = count
        self._lever, self._downward, self._pull = (
            array.tolist() for array in (self._arm.astype(np.float64), self._down, self._gravity)
        )
        self._vectors = np.zeros((count, 4, 3))
        self._vectors[:, 2] = self._down
        self._quats = np.zeros((2, count, 4))
        self._moves = np.zeros((2, 2, count, 3))

    def __call__(self, before: WorldPose, now: WorldPose) -> None:
        """Write what holds now; `before` is one physics step earlier, or the same at rest."""
        in_base = self._of_one(before, now) if self._count == 1 else self._of_all(before, now)
        for view, i in self._turned:
            view[...] = in_base[i]
        for view, i in self._copied:
            view[...] = now[i]

    def _of_all(self, before: WorldPose, now: WorldPose) -> Float64:
        """Return rates, specific force, gravity and velocity in the base, shape (4, N, 3)."""
        quats, (linear, angular) = self._quats, self._moves
        for i, pose in enumerate((before, now)):
            _, quats[i], linear[i], angular[i] = pose
        world_from_base = rotation(quats)
        vectors = self._vectors
        # Of the IMU's place, then and now.
        velocity = linear + cross(angular, world_from_base @ self._arm)
        acceleration = (velocity[1] - velocity[0]) / self._step
        vectors[:, 0], vectors[:, 3] = angular[1], linear[1]
        np.subtract(acceleration, self._gravity, out=vectors[:, 1])
        # Rows: vᵀ R = (Rᵀ v)ᵀ
        in_base: Float64 = (vectors @ world_from_base[1]).transpose(1, 0, 2)
        return in_base

    def _of_one(self, before: WorldPose, now: WorldPose) -> Sequence[tuple[float, float, float]]:
        """Return the same of one robot: after a physics step this takes a third of NumPy's time."""
        (s, t, u), _ = self._moving(before)
        (x, y, z), (a, b, c, d, e, f, g, h, i) = self._moving(now)
        step, (p, q, r) = self._step, self._pull
        force = (x - s) / step - p, (y - t) / step - q, (z - u) / step - r
        return [
            (a * x + d * y + g * z, b * x + e * y + h * z, c * x + f * y + i * z)
            for x, y, z in (now.ang_vel[0].tolist(), force, self._downward, now.lin_vel[0].tolist())
        ]

    def _moving(self, pose: WorldPose) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return the velocity of the IMU's place in the world in [m/s], and the rotation matrix."""
        w, x, y, z = pose.quat[0].tolist()
        ww = w * w
        xx = x * x
        yy = y * y
        zz = z * z
        a = ww + xx - yy - zz
        e = ww - xx + yy - zz
        i = ww - xx - yy + zz
        b = 2.0 * (x * y - w * z)
        c = 2.0 * (x * z + w * y)
        d = 2.0 * (x * y + w * z)
        f = 2.0 * (y * z - w * x)
        g = 2.0 * (x * z - w * y)
        h = 2.0 * (y * z + w * x)
        s, t, u = self._lever
        j = a * s + b * t + c * u
        k = d * s + e * t + f * u
        m = g * s + h * t + i * u
        (s, t, u), (p, q, r) = pose.lin_vel[0].tolist(), pose.ang_vel[0].tolist()
        return (s + q * m - r * k, t + r * j - p * m, u + p * k - q * j), (
            a,
            b,
            c,
            d,
            e,
            f,
            g,
            h,
            i,
        )
