"""What a MuJoCo model says about a robot's joints and feet, for checks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.models.joints import find_joints

if TYPE_CHECKING:
    from unicon_core.check.subject import Subject

__all__ = ["ModelJoints", "joint_depths", "joint_ids", "model_joints"]

Float = NDArray[np.float64]


@dataclass(frozen=True)
class ModelJoints:
    """Joints as the model file has them, in the robot's order, NaN where it does not say.

    Attributes:
        lower, upper: position range in [rad], shape (n,).
        effort: largest torque in [N·m].
        stiffness, damping: gains of position actuators in [N·m/rad], [N·m·s/rad].
        passive: damping of the joint itself in [N·m·s/rad].
    """

    lower: Float
    upper: Float
    effort: Float
    stiffness: Float
    damping: Float
    passive: Float


def joint_ids(model: Any, joints: Sequence[str], path: Path | None = None) -> list[int]:
    """Return the id of each robot joint in a model, matched as the platform matches them.

    Args:
        model: the `MjModel`.
        joints: the robot's joint names.
        path: of the model, for the message.
    """
    names = [model.joint(i).name for i in range(model.njnt)]
    return find_joints(names, joints, path or Path("model"))


def joint_depths(model: Any, joints: Sequence[str]) -> dict[str, int]:
    """Return how many joints lie between each robot joint and the world."""
    depths = {}
    for name, joint in zip(joints, joint_ids(model, joints)):
        body, depth = int(model.jnt_bodyid[joint]), 0
        while body != 0:
            depth += int(model.body_jntnum[body])
            body = int(model.body_parentid[body])
        depths[name] = depth
    return depths


def model_joints(subject: Subject) -> ModelJoints | None:
    """Return what the subject's model says, None without a model.

    The platform has turned the actuators into servos of its own, so their gains and torques are
    read from the parsed file (5 ms, not compiled again).
    """
    model, path = subject.model, subject.model_path
    if model is None or path is None:
        return None
    import mujoco

    names = subject.robot.joint_names
    ids = joint_ids(model, names, path)
    n = len(ids)
    lower, upper, effort, kp, kd = (np.full(n, np.nan) for _ in range(5))
    passive = np.array([float(model.dof_damping[model.jnt_dofadr[j]]) for j in ids])
    place = {}
    for k, joint in enumerate(ids):
        place[model.joint(joint).name] = k
        if model.jnt_limited[joint]:
            lower[k], upper[k] = model.jnt_range[joint]
        if model.jnt_actfrclimited[joint]:
            effort[k] = float(np.abs(model.jnt_actfrcrange[joint]).max())
    for actuator in mujoco.MjSpec.from_file(str(path)).actuators:
        where = place.get(actuator.target)
        if where is None:
            continue
        gear = float(actuator.gear[0])
        bias = np.asarray(actuator.biasprm, dtype=np.float64)
        torques = [float(np.abs(actuator.forcerange).max()) * gear]
        if bias[1] < 0.0:
            kp[where], kd[where] = -bias[1] * gear**2, -bias[2] * gear**2
        else:  # a motor: its control is a torque
            unit = float(actuator.gainprm[0]) * gear
            torques.append(float(np.abs(actuator.ctrlrange).max()) * unit)
        torques = [torque for torque in torques if torque > 0.0]
        if torques:
            effort[where] = np.fmin(effort[where], min(torques))
    return ModelJoints(lower, upper, effort, kp, kd, passive)
