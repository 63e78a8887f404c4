"""Stands in for joints that a model lacks and that no policy moves, for the model loader."""

from __future__ import annotations

from typing import Any

from unicon_core.errors import RobotError
from unicon_core.models.joints import is_simple
from unicon_core.robots import Robot, joint_index

_MASS, _INERTIA = 1e-6, 1e-9  # [kg], [kg·m²]: nothing that the robot feels
_ARMATURE, _DAMPING = 1e4, 1e6  # [kg·m²], [N·m·s/rad]: 100 N·m turn it by 1e-4 rad/s


def weld_absent(
    mujoco: Any, spec: Any, model: Any, robot: Robot, notes: list[str]
) -> tuple[str, ...]:
    """Add a joint that stands still for each weldable joint that a model lacks; return those.

    Each carries a body of 1 mg at the robot's base, which collides with nothing. A model that has
    none of the robot's joints, or lacks one that a policy moves, is left as it is.

    Args:
        mujoco: the module.
        spec: the `MjSpec`, changed.
        model: compiled of it.
        robot: whose joints are looked for, `weldable` among them.
        notes: is added to.
    """
    ids = [i for i in range(model.njnt) if is_simple(mujoco, model, i) and model.joint(i).name]
    names = [model.joint(i).name for i in ids]
    there, absent = [], []
    for name in robot.joint_names:
        try:
            there.append(ids[joint_index([name], names, loose=True)[0]])
        except RobotError:
            absent.append(name)
    if not absent or not there or not robot.weldable.issuperset(absent):
        return ()
    root = int(model.body_rootid[model.jnt_bodyid[there[0]]])
    base = spec.body(model.body(root).name)
    last = int(model.body_rootid[model.jnt_bodyid[model.njnt - 1]]) == root
    for name in absent:
        body = base.add_body(name=f"unicon_{name}")
        body.explicitinertial = True
        body.mass, body.inertia = _MASS, [_INERTIA] * 3
        body.add_joint(
            name=name, type=mujoco.mjtJoint.mjJNT_HINGE, armature=_ARMATURE, damping=_DAMPING
        )
    for key in list(spec.keys):
        if last and len(key.qpos) == model.nq:  # the new joints come behind all others
            key.qpos = [*key.qpos, *[0.0] * len(absent)]
            key.qvel = []
        else:
            spec.delete(key)
    notes.append(f"the model lacks {', '.join(absent)}: taken as welded")
    return tuple(absent)
