"""One robot of a URDF on a plane in MuJoCo: the physics in the stand-ins of vendors' modules."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

__all__ = ["Refused", "World", "exact"]


class Refused(AssertionError):
    """A call that the vendor's module would not have, or not then."""


def exact(value: Any, kind: type | tuple[type, ...], what: str) -> None:
    """Refuse an argument of another type."""
    if not isinstance(value, kind):
        raise Refused(f"{what} is a {type(value).__name__}")


class World:
    """The robot; links do not collide with each other.

    Args:
        urdf: its text.
        timestep: [s].
        gravity: [m/s²].
        friction: of robot and floor.
        fixed: whether the base cannot move.
        armature: of the joints by name in [kg·m²].
        damping: the same in [N·m·s/rad].
        dry: dry friction, the same in [N·m].
    """

    def __init__(
        self,
        urdf: str,
        *,
        timestep: float,
        gravity: Sequence[float],
        friction: float,
        fixed: bool,
        armature: dict[str, float] | None = None,
        damping: dict[str, float] | None = None,
        dry: dict[str, float] | None = None,
    ) -> None:
        spec = mujoco.MjSpec.from_string(urdf)
        spec.compiler.fusestatic = False
        option = spec.option
        option.timestep = timestep
        option.gravity = gravity
        option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        option.impratio = 10.0
        base = spec.worldbody.first_body()
        self.base = base.name
        self.fixed = fixed
        if not fixed:
            base.add_freejoint()
        for joint in spec.joints:
            if joint.type == mujoco.mjtJoint.mjJNT_FREE:
                continue
            joint.armature = (armature or {}).get(joint.name, 0.0)
            joint.damping = ((damping or {}).get(joint.name, 0.0), 0.0, 0.0)  # of v, v², v³
            joint.frictionloss = (dry or {}).get(joint.name, 0.0)
        for geom in spec.geoms:
            geom.contype, geom.conaffinity, geom.friction[0] = 2, 1, friction
        floor = spec.worldbody.add_geom()
        floor.type = mujoco.mjtGeom.mjGEOM_PLANE
        floor.size = (0.0, 0.0, 1.0)
        floor.contype, floor.conaffinity, floor.friction[0] = 1, 2, friction
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        kinds = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
        ids = [i for i in range(self.model.njnt) if int(self.model.jnt_type[i]) in kinds]
        # Not the order of the file, so that whoever goes by it is wrong.
        ids.sort(key=lambda i: self.model.joint(i).name[::-1])
        self.names = [self.model.joint(i).name for i in ids]
        self._qpos = self.model.jnt_qposadr[ids]
        self._dofs = self.model.jnt_dofadr[ids]
        body = self.model.body(self.base)
        self.centre = np.array(body.ipos)
        self._body = body.id

    def put(
        self,
        position: Sequence[float],
        quat: Sequence[float],
        joint_pos: Sequence[float],
        joint_vel: Sequence[float] | float = 0.0,
    ) -> None:
        """Begin anew: base [m], wxyz, and joints in the order of `names`."""
        mujoco.mj_resetData(self.model, self.data)
        if self.fixed:
            body = self.model.body(self.base)
            body.pos = position
            body.quat = quat
        else:
            self.data.qpos[:3], self.data.qpos[3:7] = position, quat
        self.data.qpos[self._qpos], self.data.qvel[self._dofs] = joint_pos, joint_vel
        mujoco.mj_forward(self.model, self.data)

    def joints(self) -> tuple[Any, Any]:
        """Return positions and velocities in the order of `names`."""
        return self.data.qpos[self._qpos].copy(), self.data.qvel[self._dofs].copy()

    def pose(self) -> tuple[Any, Any]:
        """Return position of the base's origin and orientation wxyz."""
        return self.data.xpos[self._body].copy(), self.data.xquat[self._body].copy()

    def turned(self) -> Any:
        """Return the rotation matrix base to world."""
        return self.data.xmat[self._body].reshape(3, 3).copy()

    def moves(self, at_centre: bool) -> tuple[Any, Any]:
        """Return velocity of the base, of its origin or its centre, and its rate, in the world."""
        if self.fixed:
            return np.zeros(3), np.zeros(3)
        turned = self.turned()
        rate = turned @ self.data.qvel[3:6]
        linear = self.data.qvel[:3].copy()
        return linear + np.cross(rate, turned @ self.centre) * at_centre, rate

    def move(self, linear: Any, rate: Any, at_centre: bool) -> None:
        """Give the base these velocities."""
        turned = self.turned()
        self.data.qvel[:3] = linear - np.cross(rate, turned @ self.centre) * at_centre
        self.data.qvel[3:6] = turned.T @ rate

    def step(self, torque: Sequence[float]) -> None:
        """Step once with torques in the order of `names`."""
        self.data.qfrc_applied[self._dofs] = torque
        mujoco.mj_step(self.model, self.data)
        # Poses of the end of the step, not of its beginning.
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
