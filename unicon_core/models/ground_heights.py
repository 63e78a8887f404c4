"""SceneGround: how high the ground of a simulation is at given points, for height scans.

Terrain of a scene and a model's level floor are computed; of other surroundings rays are cast.
"""

from __future__ import annotations

from copy import copy

import numpy as np

from unicon_base import ModelError
from unicon_base.arrays import Float64
from unicon_core.models.loaded import LoadedModel, around, floors, import_mujoco
from unicon_core.models.terrain import floor_of
from unicon_core.terrain.ground import Ground, ground_of
from unicon_core.terrain.heights import GroundHeights, Heights
from unicon_core.terrain.words import Terrain

NO_GROUND = -1000.0
"""Height where there is none in [m]."""


class SceneGround:
    """The ground of a scene; things that move are no ground, as they are none in Isaac Lab.

    Args:
        loaded: the model without terrain.
        terrain: of the scene, None for what the model has.

    Raises:
        ModelError: terrain needs a level floor, and the model has none.
    """

    def __init__(self, loaded: LoadedModel, terrain: Terrain | None) -> None:
        self._loaded = loaded
        self._terrain: tuple[Terrain | None, ...] = ()
        self.lay(terrain)

    def lay(self, terrain: Terrain | None) -> None:
        """Be the ground of another terrain."""
        if self._terrain == (terrain,):
            return
        self._heights: Heights
        try:
            height = floor_of(self._loaded)[1]
            ground = Ground(0.0) if terrain is None else ground_of(terrain)
            self._heights = GroundHeights(ground, height)
        except ModelError:
            if terrain is not None:
                raise
            self._heights = RayHeights(self._loaded)
        self._terrain = (terrain,)

    def __call__(self, points: Float64) -> Float64:
        """Return the heights in [m], shape (n,), of points (2, n)."""
        return self._heights(points)


class RayHeights:
    """The height of all that stands still and can be touched around a robot, by rays.

    `mj_multiRay` has one origin: it is put `UP` above the points, so that a ray is off its point by
    at most (height · radius of the points / UP), 5 µm at a height of 5 m within a radius of 1 m.

    Args:
        loaded: the model.
    """

    UP = 1e6

    def __init__(self, loaded: LoadedModel) -> None:
        mujoco = import_mujoco()
        model = self._model = copy(loaded.model)
        model.geom_group[:] = 1
        ground = [*floors(model), *around(loaded)]
        model.geom_group[ground] = 0
        model.geom_matid[ground], model.geom_rgba[ground, 3] = -1, 1.0  # rays pass what is unseen
        self._data = mujoco.MjData(model)
        mujoco.mj_forward(model, self._data)
        self._cast = mujoco.mj_multiRay
        self._groups = np.array((1, 0, 0, 0, 0, 0), np.uint8)

    def __call__(self, points: Float64) -> Float64:
        """Return the heights in [m], shape (n,), of points (2, n)."""
        count = points.shape[1]
        origin = np.array((*points.mean(axis=1), self.UP))
        rays = np.full((count, 3), -self.UP)
        np.subtract(points.T, origin[:2], out=rays[:, :2])
        geoms, far = np.zeros(count, np.int32), np.zeros(count)
        self._cast(
            self._model, self._data, origin, rays.reshape(-1), self._groups, True, -1,
            geoms, far, None, count, 2.0 * self.UP,
        )  # fmt: skip
        return np.where(geoms < 0, NO_GROUND, self.UP * (1.0 - far))
