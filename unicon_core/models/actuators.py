"""What drives the joints in a model: a motor for each, of which kind, and how strong."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from unicon_base.arrays import Float64
from unicon_core.models.loaded import LoadedModel, drives, import_mujoco
from unicon_core.robots import Robot


def actuator_kind(model: Any, i: int) -> str:
    """Return what an actuator is: `motor`, `position`, `velocity` or `general`."""
    mujoco, bias = import_mujoco(), model.actuator_biastype[i]
    if model.actuator_gaintype[i] != int(mujoco.mjtGain.mjGAIN_FIXED):
        return "general"
    if bias == int(mujoco.mjtBias.mjBIAS_NONE):
        return "motor"
    if bias != int(mujoco.mjtBias.mjBIAS_AFFINE):
        return "general"
    if model.actuator_biasprm[i, 1] != 0.0:
        return "position"
    return "velocity" if model.actuator_biasprm[i, 2] != 0.0 else "motor"


def effort_ranges(loaded: LoadedModel, robot: Robot) -> tuple[Float64, Float64]:
    """Return the torques in [N·m] between which each joint's motor stays, infinite for no limit.

    They are the tightest of the robot file's, and in the model of the control range of a motor, the
    actuator's force range and the joint's.

    Args:
        loaded: the model, its actuators as the file has them.
        robot: says the largest torques, NaN for none.

    Returns:
        Lower and upper, shape (n,) each.
    """
    model, driven = loaded.model, drives(loaded.model)
    lower, upper = np.full((2, len(loaded.joints)), np.inf)
    lower *= -1.0
    for k, (joint, effort) in enumerate(zip(loaded.joints, robot.effort_limit)):
        actuator = driven[joint][0]
        gear, ends = float(model.actuator_gear[actuator, 0]), []
        if np.isfinite(effort):
            ends.append((-float(effort), float(effort)))
        if model.actuator_ctrllimited[actuator] and actuator_kind(model, actuator) == "motor":
            gain = model.actuator_gainprm[actuator, 0]
            ends.append(model.actuator_ctrlrange[actuator] * gain * gear)
        if model.actuator_forcelimited[actuator]:
            ends.append(model.actuator_forcerange[actuator] * gear)
        if model.jnt_actfrclimited[joint]:
            ends.append(model.jnt_actfrcrange[joint])
        if ends:
            lower[k], upper[k] = np.min(ends, axis=1).max(), np.max(ends, axis=1).min()
    return lower, upper


def mend_actuators(
    spec: Any,
    model: Any,
    joints: Sequence[int],
    names: Sequence[str],
    notes: list[str],
) -> bool:
    """Give each joint a motor without dynamics of its own; return whether the spec was changed."""
    mujoco, driven, changed = import_mujoco(), drives(model), False
    added: list[str] = []
    for name, joint in zip(names, joints):
        if joint not in driven:
            actuator = spec.add_actuator(
                name=f"unicon_{name}",
                target=model.joint(joint).name,
                trntype=mujoco.mjtTrn.mjTRN_JOINT,
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
