"""Finds a robot's joints in a model by name, what turns them and the free joint above them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from unicon_core.errors import ModelError, RobotError
from unicon_core.robots import Robot, joint_index


def find_joints(mujoco: Any, model: Any, robot: Robot, path: Path) -> list[int]:
    """Return the id of each robot joint in a model, in the robot's order, by name.

    A namespace and the ending `_joint` may differ. Free and ball joints are none of a robot's.

    Args:
        mujoco: the module.
        model: the `MjModel`.
        robot: whose joints must all be there.
        path: the model's file, for the message.

    Raises:
        ModelError: a joint is not there, or two would fit.
    """
    ids = [i for i in range(model.njnt) if is_simple(mujoco, model, i) and model.joint(i).name]
    names = [model.joint(i).name for i in ids]
    try:
        return [ids[i] for i in joint_index(robot.joint_names, names, loose=True)]
    except RobotError as error:
        raise ModelError(
            f"model {path}: {error}; rename it in the model, or choose the model of this robot "
            "(scene: {model: PATH})"
        ) from error


def is_simple(mujoco: Any, model: Any, joint: int) -> bool:
    """Return whether a joint has one axis, about which it turns or along which it slides."""
    kinds = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
    return int(model.jnt_type[joint]) in kinds


def free_joint(mujoco: Any, model: Any, joint: int) -> int | None:
    """Return the id of the free joint that carries a joint's body, None for a fixed base."""
    body = int(model.jnt_bodyid[joint])
    while body:
        first = int(model.body_jntadr[body])
        if first >= 0 and int(model.jnt_type[first]) == int(mujoco.mjtJoint.mjJNT_FREE):
            return first
        body = int(model.body_parentid[body])
    return None


def drives(mujoco: Any, model: Any) -> dict[int, list[int]]:
    """Return joint id to the ids of the actuators that turn it, in the model's order."""
    kinds = mujoco.mjtTrn  # its members do not equal the model's numbers: compare as int
    turning = int(kinds.mjTRN_JOINT), int(kinds.mjTRN_JOINTINPARENT)
    found: dict[int, list[int]] = {}
    for i in range(model.nu):
        if int(model.actuator_trntype[i]) in turning:
            found.setdefault(int(model.actuator_trnid[i, 0]), []).append(i)
    return found


def position_gains(model: Any, actuator: int) -> tuple[float, float] | None:
    """Return stiffness [N·m/rad] and damping [N·m·s/rad] of a position actuator at its joint.

    Args:
        model: the `MjModel`.
        actuator: its number.

    Returns:
        None for an actuator of another kind, such as a motor.
    """
    gear, bias = float(model.actuator_gear[actuator, 0]), model.actuator_biasprm[actuator]
    return (-bias[1] * gear**2, -bias[2] * gear**2) if bias[1] < 0.0 else None
