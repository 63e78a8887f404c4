"""Frames: where places on a robot's bodies are, by forward kinematics; for blocks and checks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from unicon_base.arrays import Array, Float64
from unicon_base.errors import ModelError, alternatives
from unicon_core.models.loaded import LoadedModel, import_mujoco
from unicon_core.models.posed import PosedModel
from unicon_core.models.scalar_rotations import Quat, conjugate, multiply
from unicon_core.robots import Robot
from unicon_core.robots.robot import Place

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
        data, self._floats = posed.data, loaded.base is not None
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
            place_of, turn = data.xpos[max(root, 0)].tolist(), data.xquat[max(root, 0)].tolist()
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
            u, v, w = _turned(q, a)
            x, y, z = x + u, y + v, z + w
            q = multiply(q, r)
            if there is not None:
                (u, v, w), back = there
                x, y, z = _turned(back, (x - u, y - v, z - w))
                q = multiply(back, q)
            s, i, j, k = q
            _, _, _, os, oi, oj, ok = out.tolist()
            along = s * os + i * oi + j * oj + k * ok
            if along < 0.0 or (along != along and s < 0.0):  # nothing stood there yet: w >= 0
                s, i, j, k = -s, -i, -j, -k
            out[:] = x, y, z, s, i, j, k

    def of(self, joint_pos: ArrayLike) -> dict[str, Float64]:
        """Return name to pose in the base frame, as `__call__` writes it."""
        found = {name: np.full(7, np.nan) for name in self.names}
        self(joint_pos, list(found.values()))
        return found


def _turned(q: Sequence[float], a: Sequence[float]) -> tuple[float, float, float]:
    """Return R(q) a = a + 2 w (u x a) + 2 u x (u x a), q = (w, u) a unit quaternion."""
    (w, x, y, z), (a0, a1, a2) = q, a
    c0, c1, c2 = y * a2 - z * a1, z * a0 - x * a2, x * a1 - y * a0
    return (
        a0 + 2.0 * (w * c0 + y * c2 - z * c1),
        a1 + 2.0 * (w * c1 + z * c0 - x * c2),
        a2 + 2.0 * (w * c2 + x * c1 - y * c0),
    )
