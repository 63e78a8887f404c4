"""Joints that others pull along: where they are, and how fast they move, by those that pull."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from unicon_core.models.loaded import LoadedModel
from unicon_core.models.posed import followers

Float = NDArray[np.float64]


class Pulled:
    """Places the robot's joints in a model, and those that follow them.

    Args:
        loaded: the model; its followers are URDF's `mimic` and MJCF's `equality/joint`.

    Attributes:
        slopes: of each degree of freedom of the model by each joint of the robot, at the last
            `put`, shape (nv, n).
    """

    def __init__(self, loaded: LoadedModel) -> None:
        model = loaded.model
        self._driven = loaded.addresses
        dof = {int(model.jnt_qposadr[j]): int(model.jnt_dofadr[j]) for j in range(model.njnt)}
        self.slopes = np.zeros((model.nv, len(self._driven)))
        self.slopes[[dof[int(place)] for place in self._driven], range(len(self._driven))] = 1.0
        self._followers = [
            (place, dof[place], driver, dof.get(driver, -1), offset, start, tuple(polynomial))
            for place, driver, offset, start, polynomial in followers(loaded)
        ]
        self._linear = all(not any(each[-1][2:]) for each in self._followers)
        self._at = np.array([each[0] for each in self._followers], np.intp)
        qpos = np.array(model.qpos0)
        qpos[self._driven] = 0.0
        self._follow(qpos)
        self._fixed = qpos[self._at]  # where they are at 0, and how they go on from there
        self._rows = self.slopes[[each[1] for each in self._followers]]

    def put(self, qpos: Float, q: Float) -> None:
        """Write positions of the robot's joints, shape (n,), and of their followers into `qpos`."""
        qpos[self._driven] = q
        if self._linear:
            qpos[self._at] = self._fixed + self._rows @ q
        else:
            self._follow(qpos)

    def _follow(self, qpos: Float) -> None:
        """Follow one by one, by polynomials of any degree (MuJoCo, XML, `equality/joint`)."""
        for place, row, driver, column, offset, start, polynomial in self._followers:
            turned = float(qpos[driver]) - start if driver >= 0 else 0.0
            value = slope = 0.0
            for factor in reversed(polynomial):  # Horner's rule, and its derivative
                slope = slope * turned + value
                value = value * turned + factor
            qpos[place] = offset + value
            if column >= 0:
                np.multiply(self.slopes[column], slope, out=self.slopes[row])
