"""Chain: what of a robot moves when some of its joints do, with frames and Jacobians, for IK.

Everything is told in the robot's base frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import WorkflowError
from unicon_core.ik.model import FRAME
from unicon_core.models.loaded import LoadedModel, import_mujoco
from unicon_core.models.rows import index_of
from unicon_core.robots import Robot

Float = NDArray[np.float64]


class Chain:
    """Moved joints, k of them, and the frames of end effectors, E of them.

    Args:
        loaded: by `load_reaching`.
        robot: whose joints they are.
        effectors: names of end effectors, length E.
        moved: places of the moved joints in the robot's order, rising, shape (k,).

    Attributes:
        loaded: the model.
        data: its `MjData`, up to date after `put`.
        moved: as given.
        dofs: of the moved joints in the model, shape (k,).
        carries: which moved joints carry which end effector, shape (E, k).
        jacobian: of each end effector's position [m] and orientation [rad], by the moved joints, in
            axes of the base, shape (E, 6, k); after `differentiate`.

    Raises:
        WorkflowError: no moved joint carries an end effector.
    """

    def __init__(
        self, loaded: LoadedModel, robot: Robot, effectors: Sequence[str], moved: NDArray[np.intp]
    ) -> None:
        self._mujoco = mujoco = import_mujoco()
        model = self._model = loaded.model
        self.loaded, self.moved = loaded, moved
        self.data = mujoco.MjData(model)
        ids = [int(loaded.joints[i]) for i in moved]
        self.dofs = np.array([int(model.jnt_dofadr[i]) for i in ids], np.intp)
        self._qpos = self.data.qpos
        self._all = index_of(loaded.addresses.tolist())
        self._own = index_of([int(model.jnt_qposadr[i]) for i in ids])
        self._columns = index_of(self.dofs.tolist())
        bodies = [model.body(FRAME + each).id for each in effectors]
        self._bodies = bodies
        self.carries = np.array([self.moved_by(body) for body in bodies])
        for effector, row in zip(effectors, self.carries):
            if not row.any():
                joints = [robot.joint_names[i] for i in moved]
                raise WorkflowError(
                    f"none of the joints that it moves carries {effector!r}; name others under "
                    f"moves than {', '.join(joints[:4])}{' …' if len(joints) > 4 else ''}"
                )
        self._places = [self.data.xpos[body] for body in bodies]
        self._quats = [self.data.xquat[body] for body in bodies]
        self._whole = np.zeros((len(bodies), 6, model.nv))
        self._rows = [(each[:3], each[3:]) for each in self._whole]
        self.jacobian = self._whole[..., self._columns]

    def moved_by(self, body: int) -> NDArray[np.bool_]:
        """Return which of the moved joints move a body of the model, shape (k,)."""
        model = self._model
        above: set[int] = set()
        while body:
            first = int(model.body_dofadr[body])
            above.update(range(first, first + int(model.body_dofnum[body])))
            body = int(model.body_parentid[body])
        return np.array([dof in above for dof in self.dofs])

    def put(self, joint_pos: NDArray[Any], own: Float) -> None:
        """Put the joints somewhere.

        Args:
            joint_pos: of all joints in the robot's order in [rad], shape (n,).
            own: of the moved ones, which those of `joint_pos` do not count for, shape (k,).
        """
        self._qpos[self._all] = joint_pos
        self._qpos[self._own] = own
        self._mujoco.mj_kinematics(self._model, self.data)

    def move(self, own: Float) -> None:
        """Put the moved joints somewhere, in [rad], shape (k,)."""
        self._qpos[self._own] = own
        self._mujoco.mj_kinematics(self._model, self.data)

    def frame(self, effector: int) -> tuple[list[float], list[float]]:
        """Return position [m] and quaternion wxyz of an end effector in the base frame."""
        return self._places[effector].tolist(), self._quats[effector].tolist()

    def differentiate(self) -> None:
        """Bring `jacobian` up to date with where the joints stand."""
        mujoco, model, data = self._mujoco, self._model, self.data
        mujoco.mj_comPos(model, data)
        for body, (position, turn) in zip(self._bodies, self._rows):
            mujoco.mj_jacBody(model, data, position, turn, body)
        if not isinstance(self._columns, slice):
            np.take(self._whole, self._columns, axis=2, out=self.jacobian)
