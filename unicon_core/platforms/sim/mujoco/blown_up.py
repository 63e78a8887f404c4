"""What is said of physics that blew up: the joint, or the likeliest cause."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]


def blown_up(
    mujoco: Any, model: Any, qvel: Float, stiffness: Float, joint_names: Sequence[str]
) -> str:
    """Return what moves too fast, and what helps.

    Args:
        qvel: of the model.
        stiffness: that acts on the robot's joints in [N·m/rad], shape (n,).
        joint_names: of the robot's joints.
    """
    if np.isfinite(qvel).any():
        dof = int(np.argmax(np.nan_to_num(np.abs(qvel), nan=np.inf)))
        joint = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, int(model.dof_jntid[dof]))
        what = f"joint {joint} moves at {qvel[dof]:.3g} rad/s"
    else:  # it went through every joint within the tick: name the likeliest cause
        stiffest = int(np.argmax(np.abs(stiffness)))
        what = (
            f"no velocity is finite any more (largest stiffness: {stiffness[stiffest]:.6g} "
            f"N·m/rad at joint {joint_names[stiffest]})"
        )
    return f"{what}; lower the gains or the physics step (timestep)"
