"""How actuators that nobody commands are held."""

from __future__ import annotations

from collections.abc import Container
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.models.actuators import actuator_kind

Float = NDArray[np.float64]


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
