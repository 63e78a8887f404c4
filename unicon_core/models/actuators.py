"""What drives the joints in a model: a motor for each, of which kind, and how strong."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.models.joints import drives
from unicon_core.models.loaded import LoadedModel, import_mujoco
from unicon_core.robots import Robot

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


def effort_range(
    mujoco: Any, model: Any, joint: int, actuator: int, effort: float
) -> tuple[float, float]:
    """Return the torques in [N·m] between which a joint's motor stays, infinite for no limit.

    It is the tightest of the robot file's, and in the model of the control range of a motor, the
    actuator's force range and the joint's.

    Args:
        mujoco: the module.
        model: the `MjModel`, its actuators as the file has them.
        joint: its number.
        actuator: number of the one that turns it.
        effort: of the robot file in [N·m], NaN for none.
    """
    gear, torques = float(model.actuator_gear[actuator, 0]), []
    if np.isfinite(effort):
        torques.append((-effort, effort))
    if model.actuator_ctrllimited[actuator] and actuator_kind(mujoco, model, actuator) == "motor":
        torques.append(
            model.actuator_ctrlrange[actuator] * model.actuator_gainprm[actuator, 0] * gear
        )
    if model.actuator_forcelimited[actuator]:
        torques.append(model.actuator_forcerange[actuator] * gear)
    if model.jnt_actfrclimited[joint]:
        torques.append(model.jnt_actfrcrange[joint])
    lower = max((float(min(pair)) for pair in torques), default=-np.inf)
    return lower, min((float(max(pair)) for pair in torques), default=np.inf)


def effort_ranges(loaded: LoadedModel, robot: Robot) -> tuple[Float, Float]:
    """Return the same of all joints of a robot: lower and upper, shape (n,) each."""
    mujoco, model = import_mujoco(), loaded.model
    driven = drives(mujoco, model)
    pairs = [
        effort_range(mujoco, model, joint, driven[joint][0], float(effort))
        for joint, effort in zip(loaded.joints, robot.effort_limit)
    ]
    lower, upper = np.array(pairs, np.float64).reshape(-1, 2).T
    return lower, upper


def mend_actuators(
    mujoco: Any,
    spec: Any,
    model: Any,
    joints: Sequence[int],
    names: Sequence[str],
    notes: list[str],
) -> bool:
    """Give each joint a motor without dynamics of its own; return whether the spec was changed."""
    changed = False
    driven = drives(mujoco, model)
    added: list[str] = []
    for name, joint in zip(names, joints):
        target = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, joint)
        if joint not in driven:
            actuator = spec.add_actuator(
                name=f"unicon_{name}", target=target, trntype=mujoco.mjtTrn.mjTRN_JOINT
            )
            actuator.set_to_motor()
            added.append(name)
            changed = True
        elif model.actuator_dyntype[driven[joint][0]] != int(mujoco.mjtDyn.mjDYN_NONE):
            actuator = spec.actuators[driven[joint][0]]
            actuator.dyntype = mujoco.mjtDyn.mjDYN_NONE
            actuator.actdim = 0
            actuator.actlimited = mujoco.mjtLimited.mjLIMITED_FALSE
            actuator.actrange = [0.0, 0.0]
            notes.append(f"the actuator of {name} has dynamics of its own: they were left out")
            changed = True
    if added:
        notes.append(f"motors were added to {len(added)} joints without one: {', '.join(added)}")
    if changed:
        for key in spec.keys:  # their controls and activations no longer fit
            key.ctrl = []
            key.act = []
    return changed
