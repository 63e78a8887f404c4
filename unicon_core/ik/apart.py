"""Apart: how far a robot's capsules are from each other, and how moved joints change that."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from unicon_core.ik.chain import Chain
from unicon_core.models.loaded import import_mujoco

__all__ = ["Apart"]

Float = NDArray[np.float64]


class Apart:
    """Pairs of capsules that are kept apart, p of them.

    MuJoCo computes the distances, in closed form and in one call for all pairs.

    Args:
        chain: whose model has the pairs, by `load_apart`.
        near: distance in [m] within which pairs are looked at.

    Attributes:
        distance: of each pair in [m], negative where they overlap, at most `near`, shape (p,).
    """

    def __init__(self, chain: Chain, near: float) -> None:
        self._mujoco = import_mujoco()
        model, data = chain.loaded.model, chain.data
        self._model, self._data = model, data
        model.pair_margin[:], model.pair_gap[:] = near, 0.0
        self._pair = np.zeros((model.ngeom, model.ngeom), np.intp)
        self._sign = np.zeros((model.ngeom, model.ngeom))
        self._moves = np.zeros((model.npair, len(chain.moved)))
        for pair, geoms in enumerate(zip(model.pair_geom1, model.pair_geom2)):
            one, other = map(int, geoms)
            self._pair[one, other] = self._pair[other, one] = pair
            self._sign[one, other], self._sign[other, one] = 1.0, -1.0
            moved = [chain.moved_by(int(model.geom_bodyid[geom])) for geom in (one, other)]
            self._moves[pair] = moved[1].astype(float) - moved[0]
        self._near = near
        self.distance = np.full(model.npair, near)
        root = int(model.body_rootid[model.jnt_bodyid[chain.loaded.joints[0]]])
        self._axes, self._dofs = data.cdof, chain.dofs
        self._centre = data.subtree_com[root]

    def look(self) -> bool:
        """Bring `distance` up to date with where the chain stands; False where no pair is near."""
        self._mujoco.mj_collision(self._model, self._data)
        self.distance[:] = self._near
        if not self._data.ncon:
            return False
        contact = self._data.contact
        one, other = contact.geom.T
        # Capsules that are parallel have two points.
        np.minimum.at(self.distance, self._pair[one, other], contact.dist)
        return True

    def rows(self) -> tuple[Float, Float]:
        """Return the distances of the points that are near [m] and how moved joints change them.

        The point between two bodies moves with each of them, and what counts is the difference
        along the normal; where both move together there is none. After `look` and
        `Chain.differentiate`.

        Returns:
            Shapes (c,) and (c, k), the latter in [m/rad].
        """
        contact = self._data.contact
        one, other = contact.geom.T
        normal = contact.frame[:, :3] * self._sign[one, other, None]
        axes = self._axes[self._dofs]
        change = np.cross(contact.pos - self._centre, normal) @ axes[:, :3].T
        change += normal @ axes[:, 3:].T
        change *= self._moves[self._pair[one, other]]
        return contact.dist, change

    def joints(self, pairs: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return which moved joints move some of the pairs against each other, shape (k,)."""
        moved: NDArray[np.bool_] = self._moves[pairs].any(axis=0)
        return moved
