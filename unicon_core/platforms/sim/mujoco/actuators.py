"""What the actuators of a model are, and how those that nobody commands are held."""

from __future__ import annotations

from collections.abc import Container
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["actuator_kind", "holding"]

Float = NDArray[np.float64]


def actuator_kind(mujoco: Any, model: Any, i: int) -> str:
    """Return what an actuator is: `motor`, `position`, `velocity` or `general`."""
    if model.actuator_gaintype[i] != int(mujoco.mjtGain.mjGAIN_FIXED):
        return "general"
    if model.actuator_biastype[i] == int(mujoco.mjtBias.mjBIAS_NONE):
        return "motor"
    if model.actuator_biastype[i] != int(mujoco.mjtBias.mjBIAS_AFFINE):
        return "general"
    if model.actuator_biasprm[i, 1] != 0.0:
        return "position"
    return "velocity" if model.actuator_biasprm[i, 2] != 0.0 else "motor"


def holding(mujoco: Any, model: Any, own: Container[int], qpos: Float) -> Float:
    """Return controls that hold the joints of other position actuators (hands, objects).

    Args:
        own: actuators that are left out.
        qpos: positions that are held, as of `MjData.qpos`.

    Returns:
        As of `MjData.ctrl`.
    """
    ctrl = np.zeros(model.nu)
    for i in range(model.nu):
        if i not in own and model.actuator_trntype[i] == int(mujoco.mjtTrn.mjTRN_JOINT):
            joint = int(model.actuator_trnid[i, 0])
            if actuator_kind(mujoco, model, i) == "position":
                ctrl[i] = qpos[model.jnt_qposadr[joint]] * model.actuator_gear[i, 0]
    return ctrl
