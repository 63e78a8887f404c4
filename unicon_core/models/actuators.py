"""Gives each joint of a robot a motor without dynamics of its own, for the model loader."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from unicon_core.models.joints import drives

__all__ = ["mend_actuators"]


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
