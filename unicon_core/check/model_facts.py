"""What a model file says about a robot's joints, for checks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from unicon_base.arrays import Float64
from unicon_core.models.kinematic_tree import read_tree
from unicon_core.models.loaded import LoadedModel, drives, position_gains
from unicon_core.robots import Robot


@dataclass(frozen=True)
class ModelJoints:
    """Joints as the model file has them, in the robot's order, NaN where it does not say.

    Attributes:
        path: of the file.
        lower, upper: position range in [rad], shape (n,).
        effort: largest torque in [N·m].
        stiffness, damping: gains of position actuators in [N·m/rad], [N·m·s/rad].
        passive: damping of the joint itself in [N·m·s/rad].
        inertia: that a motor turns in the model's zero pose, armature included, in [kg·m²]; the
            diagonal of the mass matrix (MuJoCo's `dof_M0`).
    """

    path: Path
    lower: Float64
    upper: Float64
    effort: Float64
    stiffness: Float64
    damping: Float64
    passive: Float64
    inertia: Float64


def model_joints(loaded: LoadedModel | None) -> ModelJoints | None:
    """Return what a model says, None without a model."""
    if loaded is None:
        return None
    model, ids = loaded.model, loaded.joints
    lower, upper, effort, kp, kd = (np.full(len(ids), np.nan) for _ in range(5))
    driven = drives(model)
    dofs = model.jnt_dofadr[list(ids)]
    passive, inertia = model.dof_damping[dofs].astype(float), model.dof_M0[dofs].astype(float)
    for k, joint in enumerate(ids):
        if model.jnt_limited[joint]:
            lower[k], upper[k] = model.jnt_range[joint]
        if model.jnt_actfrclimited[joint]:
            effort[k] = float(np.abs(model.jnt_actfrcrange[joint]).max())
        for i in driven[joint]:  # the loader gives each joint one
            gear, gains = float(model.actuator_gear[i, 0]), position_gains(model, i)
            torques = [float(np.abs(model.actuator_forcerange[i]).max()) * gear]
            if gains is not None:
                kp[k], kd[k] = gains
            else:  # a motor: its control is a torque
                unit = float(model.actuator_gainprm[i, 0]) * gear
                torques.append(float(np.abs(model.actuator_ctrlrange[i]).max()) * unit)
            effort[k] = np.fmin(effort[k], min((t for t in torques if t > 0.0), default=np.nan))
    return ModelJoints(loaded.path, lower, upper, effort, kp, kd, passive, inertia)


def joint_depths(loaded: LoadedModel, robot: Robot, joints: Sequence[str]) -> list[int]:
    """Return how many joints are above each joint in the model, shape (n,)."""
    above: list[int] = []  # of each link
    found: dict[str, int] = {}
    for link in read_tree(loaded.model, robot):
        count = above[link.parent] if link.parent >= 0 else 0
        found[link.joint] = count
        above.append(count + bool(link.joint))
    return [found.get(name, 0) for name in joints]
