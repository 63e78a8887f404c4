"""Footprint: where a legged robot stands, level on the floor below its feet (REP-120)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.models.loaded import LoadedModel, import_mujoco
from unicon_core.models.posed import PosedModel, foot_geoms
from unicon_core.models.touching import solid
from unicon_core.robots import Robot

ORIGIN = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


class Footprint:
    """The frame `base_footprint` in the base's frame; build it with `of`.

    The floor is where the lowest foot is, the origin the mean of the feet projected on it; x points
    where the base points, z up. That needs joint positions and the base's orientation only.

    Args:
        loaded: a model with a free base.
        feet: geoms of each foot.
        joint_pos: in the robot's order in [rad] or [m], shape (n,), read in place.
        base_quat: base to world, wxyz, shape (4,), read in place.

    Attributes:
        position: in the base's frame in [m], shape (3,).
        quat: footprint to base, wxyz, shape (4,).
    """

    def __init__(
        self,
        loaded: LoadedModel,
        feet: dict[str, list[int]],
        joint_pos: NDArray[Any],
        base_quat: NDArray[Any],
    ) -> None:
        mujoco, model = import_mujoco(), loaded.model
        self._posed = PosedModel(loaded)
        self._joint_pos, self._base_quat = joint_pos, base_quat
        groups = [[g for g in group if solid(model, g)] or group for group in feet.values()]
        geoms = self._geoms = np.array([geom for group in groups for geom in group], np.intp)
        # Of the mean of the feet each foot is one part, however many geoms it has.
        self._weights = np.array([1.0 / len(g) / len(groups) for g in groups for _ in g])
        # What reaches beyond the middle of a geom: half edges of its box, or a radius.
        kinds, round_ = model.geom_type[geoms], np.zeros(len(geoms))
        self._middle = np.array(model.geom_aabb[geoms, :3])
        self._half = np.array(model.geom_aabb[geoms, 3:])
        sphere = kinds == int(mujoco.mjtGeom.mjGEOM_SPHERE)
        capsule = kinds == int(mujoco.mjtGeom.mjGEOM_CAPSULE)
        round_[sphere | capsule] = model.geom_size[geoms[sphere | capsule], 0]
        self._half[sphere] = 0.0
        self._half[capsule] = 0.0
        self._half[capsule, 2] = model.geom_size[geoms[capsule], 1]
        self._radius = round_
        self.position, self.quat = np.zeros(3), np.array((1.0, 0.0, 0.0, 0.0))

    @classmethod
    def of(
        cls, loaded: LoadedModel, robot: Robot, joint_pos: NDArray[Any], base_quat: NDArray[Any]
    ) -> Footprint | None:
        """Return that of a robot; None where it has no feet in its model, or a fixed base."""
        feet = foot_geoms(loaded.model, robot.feet)
        if robot.kind == "hand" or not feet or loaded.base is None:
            return None
        return cls(loaded, feet, joint_pos, base_quat)

    def update(self) -> None:
        """Bring `position` and `quat` up to date; keeps them where `base_quat` is not one."""
        w, x, y, z = map(float, self._base_quat)
        norm = math.sqrt(w * w + x * x + y * y + z * z)
        if not 0.5 < norm < 2.0:
            return
        w, x, y, z = w / norm, x / norm, y / norm, z / norm
        # The world's z in the base's frame.
        up = np.array((2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)))
        data = self._posed.put(self._joint_pos, ORIGIN)
        turns = data.geom_xmat[self._geoms].reshape(-1, 3, 3)
        places = data.geom_xpos[self._geoms] + np.einsum("gij,gj->gi", turns, self._middle)
        reach = (np.abs(np.einsum("gij,i->gj", turns, up)) * self._half).sum(axis=1) + self._radius
        floor = float((places @ up - reach).min())
        mean = self._weights @ places
        position = mean + (floor - float(mean @ up)) * up
        if not np.isfinite(position).all():
            return
        self.position[:] = position
        # Base to world is yaw · rest, so footprint to base is (yaw⁻¹ · base)⁻¹.
        half = 0.5 * math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        c, s = math.cos(half), math.sin(half)
        self.quat[:] = (c * w + s * z, -(c * x + s * y), -(c * y - s * x), -(c * z - s * w))
