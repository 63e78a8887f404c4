"""Newton's solver and its states, in the kit's units and frames.

Newton 1.8 has quaternions xyzw. Its free joint has seven coordinates, the position of the body's
origin and the quaternion, and six velocities along the world's axes: that of the centre of mass,
then the rate. https://newton-physics.github.io/newton/latest/concepts/conventions.html
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.platforms.kit.base import rotation

Float = NDArray[np.float64]


class Engine:
    """A model of one world or of several that are equal, with a solver.

    Args:
        model: finalized; where its joints stand is where a reset leads.
        solver: of that model, a `SolverMuJoCo`.
        joints: numbers of Newton's joints in the first world, in the robot's order, n.

    Attributes:
        worlds: how many there are.
    """

    def __init__(self, model: Any, solver: Any, joints: list[int]) -> None:
        self.worlds = max(int(model.world_count), 1)
        self._model, self._solver = model, solver
        self._q = model.joint_q_start.numpy()[joints]
        self._v = model.joint_qd_start.numpy()[joints]
        self._centre = np.array(model.body_com.numpy()[0], np.float64)  # of the base
        self._now, self._next, self._control = model.state(), model.state(), model.control()
        self._force = np.zeros((self.worlds, model.joint_dof_count // self.worlds), np.float32)

    def _rows(self, array: Any) -> NDArray[np.float32]:
        """Return what Newton has in one array for all worlds, one row each."""
        rows: NDArray[np.float32] = array.numpy().reshape(self.worlds, -1)
        return rows

    def place(self) -> None:
        """Put all joints where the model has them, at rest, and forget contacts and warm starts."""
        self._control.joint_f.zero_()
        self._solver.reset(self._now)

    def joints(self) -> tuple[Any, Any]:
        """Return positions and velocities, float32, shape (worlds, n) each."""
        now = self._now
        return self._rows(now.joint_q)[:, self._q], self._rows(now.joint_qd)[:, self._v]

    def base(self) -> tuple[Float, Float, Float, Float]:
        """Return the values of a `WorldPose`, shape (worlds, 3) or (worlds, 4)."""
        pose = self._rows(self._now.joint_q)[:, :7].astype(np.float64)
        twist = self._rows(self._now.joint_qd)[:, :6].astype(np.float64)
        quat, rate = pose[:, (6, 3, 4, 5)], twist[:, 3:]
        quat /= np.linalg.norm(quat, axis=1, keepdims=True)
        centre = rotation(quat) @ self._centre  # from the origin, along the world's axes
        return pose[:, :3], quat, twist[:, :3] - np.cross(rate, centre), rate

    def step(self, torque: Float, timestep: float) -> None:
        """Apply torques [N·m], shape (worlds, n), and step the physics."""
        self._force[:, self._v] = torque
        self._control.joint_f.assign(self._force.ravel())
        self._solver.step(self._now, self._next, self._control, None, timestep)
        self._now, self._next = self._next, self._now

    def add_velocity(self, velocity: Float) -> None:
        """Add to the bases' velocities [m/s] in the world, shape (worlds, 3)."""
        rows = self._rows(self._now.joint_qd).copy()
        rows[:, :3] += velocity
        self._now.joint_qd.assign(rows.ravel())

    def damp(self, damping: Float, flag: Any) -> None:
        """Give the joints damping [N·m·s/rad], shape (n,).

        Args:
            damping: in the robot's order.
            flag: of `newton.ModelFlags`, for a force of joints that has changed.
        """
        rows = self._rows(self._model.joint_damping).copy()
        rows[:, self._v] = damping
        self._model.joint_damping.assign(rows.ravel())
        self._solver.notify_model_changed(flag)
