"""Apart: how far a robot's capsules are from each other, and how moved joints change that."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from unicon_core.ik.chain import Chain
from unicon_core.models.loaded import import_mujoco
from unicon_core.models.rows import index_of

Float = NDArray[np.float64]

# a × n = (a @ _CROSS).reshape(3, 3) @ n
_CROSS = np.zeros((3, 9))
for _i, _j, _k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    _CROSS[_i, 3 * _k + _j], _CROSS[_i, 3 * _j + _k] = 1.0, -1.0


class Apart:
    """Pairs of capsules that are kept apart, p of them.

    MuJoCo computes the distances, in closed form and in one call for all pairs: 2 µs for 74 of
    them, where one call for each pair takes 1 µs.

    Args:
        chain: whose model has the pairs, by `load_apart`.
        near: distance in [m] within which pairs are looked at.
        least: distance in [m] below which pairs are too near.
    """

    def __init__(self, chain: Chain, near: float, least: float) -> None:
        self._mujoco = import_mujoco()
        model, data = chain.loaded.model, chain.data
        self._model, self._data = model, data
        model.pair_margin[:], model.pair_gap[:] = near, 0.0
        pairs = model.npair
        self._row = np.zeros(model.ngeom**2, np.intp)
        self._code = np.array((model.ngeom, 1))
        self._moves = np.zeros((2 * pairs, len(chain.moved)))
        for pair, geoms in enumerate(zip(model.pair_geom1, model.pair_geom2)):
            one, other = map(int, geoms)
            moved = [chain.moved_by(int(model.geom_bodyid[geom])) for geom in (one, other)]
            self._moves[pair] = moved[1].astype(float) - moved[0]
            self._row[self._code @ (one, other)] = pair
            self._row[self._code @ (other, one)] = pair + pairs
        self._moves[pairs:] = -self._moves[:pairs]
        self._least, self._pairs = least, pairs
        self._before, self._now = np.full(pairs, least), np.full(pairs, least)
        root = int(model.body_rootid[model.jnt_bodyid[chain.loaded.joints[0]]])
        self._axes, self._dofs = data.cdof, index_of(chain.dofs.tolist())
        self._centre = data.subtree_com[root]

    def rows(self) -> tuple[Float, Float]:
        """Return the distances of points that are near [m], and how moved joints change them.

        Where a body turns about an axis, a point on it moves by the cross product; of the two
        bodies at a point the difference along the normal counts, and none where both move
        together. After `Chain.differentiate`.

        Returns:
            Shapes (c,) and (c, k), the latter in [m/rad].
        """
        self._mujoco.mj_collision(self._model, self._data)
        contact = self._data.contact
        count = len(contact)
        distance = contact.dist
        row = self._row[contact.geom @ self._code]
        self._before[:] = self._least
        if count and distance.min() < self._least:
            np.minimum.at(self._before, row % self._pairs, distance)
        twist = np.empty((count, 6))
        normal = twist[:, 3:]
        normal[:] = contact.frame[:, :3]
        arm = contact.pos - self._centre
        np.matmul((arm @ _CROSS).reshape(-1, 3, 3), normal[..., None], out=twist[:, :3, None])
        change = twist @ self._axes[self._dofs].T
        change *= self._moves[row]
        return distance, change

    def too_near(self) -> NDArray[np.bool_] | None:
        """Return which moved joints bring pairs nearer than they may be, shape (k,), or None.

        A pair that was too near in `rows` may be as near as it was.
        """
        self._mujoco.mj_collision(self._model, self._data)
        contact = self._data.contact
        distance = contact.dist
        if not len(distance) or distance.min() >= self._least:
            return None
        row = self._row[contact.geom @ self._code] % self._pairs
        self._now[:] = self._least
        np.minimum.at(self._now, row, distance)
        wrong = self._now < self._before
        if not wrong.any():
            return None
        return np.asarray(self._moves[: self._pairs][wrong].any(axis=0))
