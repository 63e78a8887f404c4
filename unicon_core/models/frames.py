"""Frames on a robot's bodies by forward kinematics, and rotations of plain floats.

The rotations are for what computes a few in a tick: NumPy takes longer for arrays so small, 20 µs
for a product that takes 0.6 µs here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from unicon_base import ModelError, alternatives
from unicon_base.arrays import Array, Float64
from unicon_core.models.loaded import LoadedModel, import_mujoco
from unicon_core.models.posed import PosedModel
from unicon_core.robots import Robot
from unicon_core.robots.robot import Place

Quat: TypeAlias = tuple[float, float, float, float]
Vector: TypeAlias = tuple[float, float, float]
Floats: TypeAlias = Sequence[float]


def plus(a: Floats, b: Floats, factor: float = 1.0) -> Vector:
    """Return the sum of a vector and a multiple of another."""
    return a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]


def multiply(a: Floats, b: Floats) -> Quat:
    """Return the product of two quaternions wxyz."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def conjugate(a: Floats) -> Quat:
    """Return the inverse of a unit quaternion wxyz."""
    return a[0], -a[1], -a[2], -a[3]


def rotate(q: Floats, a: Floats) -> Vector:
    """Return R(q) a = a + 2 w (u x a) + 2 u x (u x a), q = (w, u) a unit quaternion."""
    (w, x, y, z), (a0, a1, a2) = q, a
    c0 = y * a2 - z * a1
    c1 = z * a0 - x * a2
    c2 = x * a1 - y * a0
    return (
        a0 + 2.0 * (w * c0 + y * c2 - z * c1),
        a1 + 2.0 * (w * c1 + z * c0 - x * c2),
        a2 + 2.0 * (w * c2 + x * c1 - y * c0),
    )


def turned(axis: Floats, angle: float) -> Quat:
    """Return the quaternion wxyz of a turn by an angle in [rad] about a unit vector."""
    half = 0.5 * angle
    s = math.sin(half) if math.isfinite(half) else math.nan
    c = math.cos(half) if math.isfinite(half) else math.nan
    return c, s * axis[0], s * axis[1], s * axis[2]


def yaw_of(a: Floats) -> float:
    """Return the heading of a unit quaternion wxyz in [rad]: the last of roll, pitch and yaw."""
    w, x, y, z = a
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def vector_of(a: Floats) -> Vector:
    """Return the rotation vector of a unit quaternion wxyz in [rad], the shorter way round."""
    w, x, y, z = a if a[0] >= 0.0 else (-a[0], -a[1], -a[2], -a[3])
    s = math.sqrt(x * x + y * y + z * z)
    factor = 2.0 * math.atan2(s, w) / s if s > 1e-9 else 2.0
    return factor * x, factor * y, factor * z


def towards(a: Floats, b: Floats, share: float) -> Quat:
    """Return the unit quaternion wxyz that is a share of the shorter way from one to another.

    Shoemake 1985, "Animating rotation with quaternion curves", as a turn about one axis. Its sign
    is that of the first one.
    """
    x, y, z = vector_of(multiply(b, conjugate(a)))
    angle = math.sqrt(x * x + y * y + z * z)
    if angle < 1e-9:
        return a[0], a[1], a[2], a[3]
    w, i, j, k = multiply(turned((x / angle, y / angle, z / angle), share * angle), a)
    length = math.sqrt(w * w + i * i + j * j + k * k)
    return w / length, i / length, j / length, k / length


def turn_between(a: Floats, b: Floats) -> Vector:
    """Return the rotation vector [rad] that turns one orientation into another, the shorter way.

    Args:
        a: unit quaternion wxyz, that of a body.
        b: likewise, that which is wanted; the vector is in the axes that both are told in.
    """
    return vector_of(multiply(b, conjugate(a)))


def turned_by(quat: Floats, velocity: Floats, duration: float) -> Quat:
    """Return an orientation after a turn at constant velocity.

    Args:
        quat: unit quaternion wxyz.
        velocity: in [rad/s], in the axes that the quaternion leads to.
        duration: in [s].
    """
    i, j, k = velocity
    speed = math.sqrt(i * i + j * j + k * k)
    half = 0.5 * speed * duration
    s = math.sin(half) / speed if speed > 1e-9 else 0.5 * duration
    return multiply((math.cos(half), s * i, s * j, s * k), quat)


_HERE = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


def body_of(loaded: LoadedModel, place: Place, what: str) -> int:
    """Return the number of the body that carries a place.

    Args:
        loaded: the model.
        place: on one of its bodies.
        what: it is, for the message.

    Raises:
        ModelError: the model has no such body.
    """
    model = loaded.model
    names = [model.body(i).name for i in range(model.nbody)]
    if place.body not in filter(None, names):
        known = alternatives(place.body, names[1:])
        raise ModelError(f"{what}: no body {place.body!r} in {loaded.path}; {known}")
    return names.index(place.body)


class Frames:
    """Poses of places on the bodies of a robot, all by one pass through its model.

    A place at a, turned by r, on a body at p, turned by q, is at p + R(q) a, turned by q r. A base
    that floats is put where it is said to be; in the base frame it stands at the origin. Where the
    base is fixed, its frame is that of the body `base_frame` of the robot file, or the model's.

    Args:
        loaded: the model.
        robot: names the base.
        places: name to place.

    Attributes:
        names: of the places, length k.

    Raises:
        ModelError: a body is not in the model.
    """

    def __init__(self, loaded: LoadedModel, robot: Robot, places: Mapping[str, Place]) -> None:
        self._posed = posed = PosedModel(loaded)
        data = posed.data
        self._floats = loaded.base is not None
        self.names = tuple(places)
        self._bodies = []
        for name, place in places.items():
            body = body_of(loaded, place, f"end effector {name!r}")
            self._bodies.append((data.xpos[body], data.xquat[body], place.position, place.quat))
        posed.put(robot.default_joint_pos, _HERE)
        self._base: tuple[Sequence[float], Quat] | None = None
        if not self._floats:
            mujoco = import_mujoco()
            root = mujoco.mj_name2id(loaded.model, mujoco.mjtObj.mjOBJ_BODY, robot.base_frame)
            place_of = data.xpos[max(root, 0)].tolist()
            turn = data.xquat[max(root, 0)].tolist()
            if [*place_of, *turn] != list(_HERE):
                self._base = place_of, conjugate(turn)

    def __call__(
        self, joint_pos: ArrayLike, outs: Sequence[Array], base: ArrayLike | None = None
    ) -> None:
        """Write each pose: position in [m] and quaternion wxyz, of the sign that stood there.

        Args:
            joint_pos: in the robot's order in [rad] or [m], shape (n,).
            outs: for each place, shape (7,).
            base: position in [m] and quaternion wxyz in the world, shape (7,), for poses there;
                None for poses in the base frame.
        """
        self._posed.put(joint_pos, _HERE if base is None else base)
        there = self._base if base is None else None
        for (at, turn, a, r), out in zip(self._bodies, outs):
            q = turn.tolist()
            x, y, z = at.tolist()
            u, v, w = rotate(q, a)
            x = x + u
            y = y + v
            z = z + w
            q = multiply(q, r)
            if there is not None:
                (u, v, w), back = there
                x, y, z = rotate(back, (x - u, y - v, z - w))
                q = multiply(back, q)
            s, i, j, k = q
            _, _, _, os, oi, oj, ok = out.tolist()
            along = s * os + i * oi + j * oj + k * ok
            if along < 0.0 or (along != along and s < 0.0):  # nothing stood there yet: w >= 0
                s = -s
                i = -i
                j = -j
                k = -k
            out[:] = x, y, z, s, i, j, k

    def of(self, joint_pos: ArrayLike) -> dict[str, Float64]:
        """Return name to pose in the base frame, as `__call__` writes it."""
        found = {name: np.full(7, np.nan) for name in self.names}
        self(joint_pos, list(found.values()))
        return found
