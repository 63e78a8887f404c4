"""Feet of a legged robot: where they are, how fast, what they bear; for odometry.

All is told in a frame at the base's origin whose axes are the world's: what the legs' kinematics
and an IMU's orientation give, without knowing where the base is.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import as_strided

from unicon_base import ModelError
from unicon_base.arrays import Array, Float64, Index
from unicon_core.models.loaded import (
    LoadedModel,
    dofs_above,
    import_mujoco,
    index_of,
    rows_of,
    solid,
)
from unicon_core.models.posed import foot_bodies, foot_geoms
from unicon_core.robots import Robot

GRAVITY = 9.81
"""In [m/s²]."""
# Damping of the least squares, in [m²] and none: legs move a foot by 0.1 m for a radian or more,
# and where their joints cannot tell force from moment, 10 N are as likely as 1 N·m.
_OF_FORCE = 1e-5
_OF_MOMENT = 1e-3
# Squared norm of all that is measured, in [rad²], [rad²/s²], [N²·m²]: no robot has so much.
_SENSE = 1e8
CROSS = np.zeros((3, 9))
for _i, _j, _k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    CROSS[_k, 3 * _i + _j], CROSS[_k, 3 * _j + _i] = -1.0, 1.0
"""(r @ CROSS).reshape(3, 3) is M(r), with a × r = a @ M(r) and r × a = M(r) @ a."""


class Feet:
    """The feet of a robot's model, F of them.

    Of each the lowest point counts: it touches the ground first, and a body that rolls on it does
    not move there. Forces follow from the joints' torques, f = (Jᵀ)⁺ (h(q, q̇) - τ), with h what the
    leg's own weight and turning ask for (Featherstone, Rigid Body Dynamics Algorithms, 2008, 5.3);
    what its acceleration asks for is left out. A leg of more than three joints may bear a moment,
    too: f is then force and moment together.

    Args:
        loaded: the model.
        robot: names its feet.

    Attributes:
        names: of the feet, length F.
        weight: of the robot in [N].
        position: lowest point of each foot in [m], shape (F, 3).
        velocity: of that point against the base's origin in [m/s], shape (F, 3).
        force: that the ground pushes up with in [N], shape (F,).

    Raises:
        ModelError: the base is fixed, or none of the feet is in the model.
    """

    def __init__(self, loaded: LoadedModel, robot: Robot) -> None:
        self._mujoco = mujoco = import_mujoco()
        model = self._model = loaded.model
        found = foot_bodies(model, robot.feet)
        base = loaded.base
        if base is None or not found:
            lacking = "feet" if base is not None else "free joint of its base"
            raise ModelError(
                f"model {loaded.path}: it has no {lacking} (feet of robot {robot.name}: "
                f"{', '.join(robot.feet) or 'none'}); name bodies, sites or geoms of the model "
                "under feet in the robot file"
            )
        self.names = tuple(found)
        data = self._data = mujoco.MjData(model)
        start = int(model.jnt_qposadr[base])
        first = int(model.jnt_dofadr[base])
        data.qpos[start : start + 7] = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
        self._quat = data.qpos[start + 3 : start + 7]
        self._turning = data.qvel[first + 3 :][:3]
        self._qpos = data.qpos
        self._qvel = data.qvel
        self._positions = index_of(loaded.addresses.tolist())
        self._velocities = index_of(loaded.dofs.tolist())
        trunk = int(model.jnt_bodyid[base])
        self.weight = float(model.body_subtreemass[trunk]) * GRAVITY
        self._centre = data.subtree_com[int(model.body_rootid[trunk])]
        count = len(found)
        self._moved: list[Callable[[], object]] = []
        self.position = np.zeros((count, 3))
        self.velocity = np.zeros((count, 3))
        self.force = np.zeros(count)
        self._arm = np.zeros((count, 3))
        self._across = np.zeros((count, 9))
        self._cross = self._across.reshape(count, 3, 3)
        self._turned = self.velocity[:, None]
        body = np.array(list(found.values()), np.intp)
        twists = self._rows(data.cvel, body)
        self._spin = twists[:, None, :3]
        self._shift = twists[:, 3:]
        self._find_points(_points(model, found, robot), body)
        self._find_legs(_dofs(model, body, first))

    def _rows(self, source: Float64, index: Index) -> Float64:
        """Return rows of an array of the data, which each call brings up to date."""
        rows, refresh = rows_of(source, index)
        self._moved += [refresh] if refresh is not None else []
        return rows

    def _find_points(self, points: tuple[Float64, Float64], body: Index) -> None:
        """Keep where each foot may touch the ground."""
        self._points, self._radius = points
        count, most = self._radius.shape
        self._each = np.arange(count)
        self._places = np.zeros((count, most, 3))
        self._origins = self._rows(self._data.xpos, body)
        turns = self._rows(self._data.xmat, body)
        self._turns = as_strided(turns, (count, 3, 3), (turns.strides[0], 8, 24))  # transposed

    def _find_legs(self, dofs: Index) -> None:
        """Keep the degrees of freedom of each leg, shape (F, most), -1 for none."""
        model = self._model
        data = self._data
        self._own = (dofs >= 0)[..., None] if (dofs < 0).any() else None
        self._torque = np.zeros(model.nv)
        self._asked = np.zeros(model.nv)
        count, most = dofs.shape
        rows = 3 if most <= 3 else 6  # three joints bear no moment of a foot
        axes = self._rows(data.cdof, dofs)
        self._turn_axes = axes[..., :3]
        self._shift_axes = axes[..., 3:]
        self._jacobian = np.zeros((count, most, rows))  # transposed
        self._by_force = self._jacobian[..., :3]
        self._by_moment = self._jacobian[..., 3:]
        self._back = self._jacobian.transpose(0, 2, 1)
        self._legs, self._refresh_legs = rows_of(self._asked, dofs)
        self._damping = np.diag([_OF_FORCE] * 3 + [_OF_MOMENT] * (rows - 3))
        self._square = np.zeros((count, rows, rows))
        self._pushed = np.zeros((count, rows, 1))

    def __call__(
        self,
        quat: Array,
        ang_vel: Array,
        joint_pos: Array,
        joint_vel: Array,
        joint_effort: Array | None,
    ) -> bool:
        """Compute what the attributes tell; False where the arguments make no sense.

        Args:
            quat: base to world, wxyz, shape (4,).
            ang_vel: of the base, in its frame, [rad/s], shape (3,).
            joint_pos, joint_vel, joint_effort: in the robot's order, shape (n,); without torques
                `force` stays as it is.
        """
        mujoco = self._mujoco
        model = self._model
        data = self._data
        qpos = self._qpos
        qvel = self._qvel
        torque = self._torque
        self._quat[:] = quat
        self._turning[:] = ang_vel
        qpos[self._positions] = joint_pos
        qvel[self._velocities] = joint_vel
        if joint_effort is not None:
            torque[self._velocities] = joint_effort
        if not qpos.dot(qpos) + qvel.dot(qvel) + torque.dot(torque) < _SENSE:  # nor NaN
            return False
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        for refresh in self._moved:
            refresh()
        places = self._places
        position = self.position
        np.matmul(self._points, self._turns, out=places)
        places[..., 2] -= self._radius
        if len(places[0]) > 1:
            places = places[self._each, places[..., 2].argmin(1)]
        np.add(places.reshape(-1, 3), self._origins, out=position)
        np.subtract(position, self._centre, out=self._arm)
        np.matmul(self._arm, CROSS, out=self._across)
        np.matmul(self._spin, self._cross, out=self._turned)
        self.velocity += self._shift
        if joint_effort is not None:
            self._bear()
        return True

    def _bear(self) -> None:
        asked = self._asked
        square = self._square
        self._mujoco.mj_rne(self._model, self._data, 0, asked)
        asked -= self._torque
        if self._refresh_legs is not None:
            self._refresh_legs()
        np.matmul(self._turn_axes, self._cross, out=self._by_force)
        self._by_force += self._shift_axes
        if self._by_moment.size:
            self._by_moment[:] = self._turn_axes
        if self._own is not None:
            self._jacobian *= self._own
        np.matmul(self._back, self._jacobian, out=square)
        square += self._damping
        np.matmul(self._back, self._legs[..., None], out=self._pushed)
        self.force[:] = np.linalg.solve(square, self._pushed)[:, 2, 0]


def _dofs(model: Any, bodies: Index, first: int) -> Index:
    """Return the degrees of freedom between the base and each foot, shape (F, most), -1 for none.

    Args:
        first: the base's own, six of them.
    """
    legs = [[dof for dof in dofs_above(model, int(b)) if dof >= first + 6] for b in bodies]
    most = max(map(len, legs))
    return np.array([leg[::-1] + [-1] * (most - len(leg)) for leg in legs], np.intp)


def _points(model: Any, bodies: dict[str, int], robot: Robot) -> tuple[Float64, Float64]:
    """Return where each foot may touch the ground: centres of spheres in the body's frame, radii.

    Shapes (F, most, 3) and (F, most) in [m]. Where the model has no shape, as where meshes are
    absent, it is the body's origin.
    """
    geoms = foot_geoms(model, robot.feet)
    places: list[Float64] = []
    radii: list[Float64] = []
    for foot, body in bodies.items():
        own = [g for g in geoms.get(foot, []) if model.geom_bodyid[g] == body]
        touching = [geom for geom in own if solid(model, geom)]
        parts = [_of_geom(model, geom) for geom in touching or own]
        parts = parts or [(np.zeros((1, 3)), 0.0)]
        places.append(np.concatenate([at for at, _ in parts]))
        radii.append(np.concatenate([np.full(len(at), radius) for at, radius in parts]))
    most = max(map(len, places))
    rows = [np.resize(np.arange(len(at)), most) for at in places]  # the same ones again
    return (
        np.array([at[row] for at, row in zip(places, rows)]),
        np.array([radius[row] for radius, row in zip(radii, rows)]),
    )


def _of_geom(model: Any, geom: int) -> tuple[Float64, float]:
    """Return the spheres that a geom is made of, or its corners: their centres, and the radius."""
    mujoco = import_mujoco()
    kinds = mujoco.mjtGeom
    kind = int(model.geom_type[geom])
    size = np.array(model.geom_size[geom])
    middle = np.zeros(3)
    half = np.array(model.geom_aabb[geom, 3:])
    radius = 0.0
    signs = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, -1).T
    if kind == int(kinds.mjGEOM_SPHERE):
        signs = np.zeros((1, 3))
        radius = float(size[0])
    elif kind == int(kinds.mjGEOM_CAPSULE):
        signs = np.array(((0.0, 0.0, -1.0), (0.0, 0.0, 1.0)))
        radius = float(size[0])
        half = np.array((0.0, 0.0, size[1]))
    else:
        middle = np.array(model.geom_aabb[geom, :3])
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
    return (middle + signs * half) @ turn.reshape(3, 3).T + model.geom_pos[geom], radius
