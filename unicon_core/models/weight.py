"""Weight: the torques that hold a robot's own links against gravity; for the block `gravity`."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from unicon_core.models.loaded import LoadedModel, import_mujoco
from unicon_core.models.posed import PosedModel, foot_bodies
from unicon_core.models.rows import index_of
from unicon_core.robots import Robot


class Weight:
    """What the joints of a model have to give so that it stays where it is, with nothing in touch.

    The torques of M(q) q̈ + h(q, q̇) = τ at rest, τ = h(q, 0), by one pass of the recursive
    Newton-Euler algorithm (Featherstone, Rigid Body Dynamics Algorithms, 2008, 5.3): of each joint
    it is the weight of all that it carries.

    Args:
        loaded: the model.

    Attributes:
        floats: the base moves, and is turned as it is said to be; a fixed one is turned as the
            model says.
    """

    def __init__(self, loaded: LoadedModel) -> None:
        self._model, self._posed = loaded.model, PosedModel(loaded)
        self._mujoco, self.floats = import_mujoco(), loaded.base is not None
        model = loaded.model
        self._dofs = index_of([int(model.jnt_dofadr[joint]) for joint in loaded.joints])
        self._asked, self._base = np.zeros(model.nv), np.array((0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0))

    def __call__(
        self, joint_pos: ArrayLike, out: NDArray[np.float64], quat: ArrayLike | None = None
    ) -> None:
        """Write the torques in [N·m], or forces in [N], in the robot's order, shape (n,).

        Args:
            joint_pos: in [rad] or [m], shape (n,).
            out: shape (n,).
            quat: base to world, wxyz, shape (4,); None leaves it as it is.
        """
        if quat is not None:
            self._base[3:] = quat
        data = self._posed.put(joint_pos, self._base)
        self._mujoco.mj_rne(self._model, data, 0, self._asked)  # its velocities are 0 for ever
        out[:] = self._asked[self._dofs]


def bearing_joints(loaded: LoadedModel, robot: Robot) -> NDArray[np.bool_]:
    """Return which joints stand between the base and a foot, in the robot's order, shape (n,).

    Those of a robot that does not walk, such as the fingertips of a hand, bear nothing.
    """
    model = loaded.model
    bodies: set[int] = set()
    for foot in foot_bodies(model, robot.feet if robot.walks else ()).values():
        body = foot
        while body:
            bodies.add(body)
            body = int(model.body_parentid[body])
    return np.array([int(model.jnt_bodyid[joint]) in bodies for joint in loaded.joints], np.bool_)
