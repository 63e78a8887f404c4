"""What one simulated robot measures: its joints and its base, out of its `MjData`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from numpy.typing import NDArray

from unicon_core.models.loaded import LoadedModel
from unicon_core.models.rows import index_of
from unicon_core.platforms.sim.mujoco.imu import BaseReader


class Reader:
    """Copies joints and base of one robot into arrays.

    Args:
        mujoco: the module.
        loaded: the model.
        data: the robot's `MjData`.
        views: arrays by state, without a batch axis; what is not among them is left out.

    Attributes:
        sources: what the base states are read from, as of `BaseReader`; {} for a fixed base.
    """

    def __init__(
        self, mujoco: Any, loaded: LoadedModel, data: Any, views: Mapping[str, NDArray[Any]]
    ) -> None:
        model, joints, base = loaded.model, loaded.joints, loaded.base
        q_index = index_of([int(model.jnt_qposadr[j]) for j in joints])
        v_index = index_of([int(model.jnt_dofadr[j]) for j in joints])
        sources = ((data.qpos, q_index), (data.qvel, v_index), (data.qfrc_actuator, v_index))
        self._copies = [
            (views[name], source[index] if isinstance(index, slice) else None, source, index)
            for name, (source, index) in zip(("joint_pos", "joint_vel", "joint_effort"), sources)
            if name in views
        ]
        arm = loaded.imu_position
        self._base = (
            None if base is None else BaseReader(mujoco, model, data, base, dict(views), arm)
        )
        self.sources = {} if self._base is None else dict(self._base.source)

    def __call__(self) -> None:
        for out, view, source, index in self._copies:
            out[...] = source[index] if view is None else view
        if self._base is not None:
            self._base()
