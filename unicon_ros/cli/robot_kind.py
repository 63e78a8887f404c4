"""Kind and feet of a robot, from its model: free joint, limbs, and how all of them are called.

A limb is a chain of joints up to a tip: it begins at the base, or where the tree last branches.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from unicon_base import RobotError
from unicon_base.arrays import Float64
from unicon_core.models.loaded import free_joint, import_mujoco
from unicon_core.robots.file import KINDS

Joints = Sequence[int]

_LEG = re.compile(
    r"hip|knee|ankle|thigh|calf|shank|abad|foot|toe|(^|_)u?leg(_|\d|$)|(^|_)(haa|[hkf]fe)(_|$)",
    re.IGNORECASE,
)
_ARM = re.compile(r"shoulder|elbow|wrist|gripper|(^|_)arm", re.IGNORECASE)
_FINGER = re.compile(r"thumb|finger|palm", re.IGNORECASE)
_WHEEL = re.compile(r"wheel|caster|whl", re.IGNORECASE)
_FOOT = re.compile(r"foot|feet|toe", re.IGNORECASE)
# FL, HR and the like: of its leg's last body, the sphere that touches the ground.
_CORNER = re.compile(r"^[A-Z]{2}$")
# Share of a robot's height within which limbs end on one ground, with all joints at 0: a G1's hands
# hang at half of its height, an ANYmal's feet differ by nothing.
_NEAR = 0.15
# Joints that a hand may turn on as a whole; more of them are an arm, whose gripper it is.
_OF_WRIST = 2
# Range in [rad] beyond which a limit stands for none: LimX writes ±1e3 and ±1e6 for wheels.
_TURNS = 8.0 * math.pi


@dataclass(frozen=True)
class _Limb:
    """A limb: its joints, tip first; of its lowest body the height in [m]; whether it is a wheel's.

    `leggy`: joints or bodies are called as a leg's are.
    """

    joints: tuple[int, ...]
    height: float
    wheel: bool
    leggy: bool


def wheels_of(model: Any, joints: Joints) -> set[str]:
    """Return the names of joints that are those of wheels.

    They turn without end and are alone in a limb, end one whose other joints have limits, or are
    called so.

    Args:
        model: an `MjModel`.
        joints: numbers of the robot's joints.
    """
    limbs = _limbs(model, joints)
    return {model.joint(limb.joints[0]).name for limb in limbs if limb.wheel}


def legs_of(model: Any, joints: Joints) -> list[tuple[int, ...]]:
    """Return the joints of each leg, tip first; see `kind_of`."""
    legs, _ = _legs(model, joints, _limbs(model, joints))
    return [leg.joints for leg in legs]


def kind_of(model: Any, joints: Joints, source: str) -> tuple[str, str]:
    """Return the kind of a robot, and what in its model says so.

    Legs are the limbs that reach the ground where all joints are at 0, else those that are called
    so. Two make a humanoid, four a quadruped; a robot that stands on wheels is wheeled.

    Args:
        model: an `MjModel`.
        joints: numbers of the robot's joints, all in one tree.
        source: names the model in the message.

    Raises:
        RobotError: the model does not say; the message asks for the kind.
    """
    limbs = _limbs(model, joints)
    leggy = any(limb.leggy for limb in limbs)
    carrying = len(joints) - sum(len(limb.joints) for limb in limbs)
    fingers = any(_FINGER.search(model.joint(joint).name) for joint in joints)
    if not leggy and fingers and carrying <= _OF_WRIST:
        return "hand", "its joints are called as a hand's are"
    down = _down(model, joints, limbs)
    wheels = [limb for limb in limbs if limb.wheel]
    if len(wheels) > 1 and all(limb.wheel for limb in down):
        return "wheeled", f"{len(wheels)} limbs end in a wheel"
    free = free_joint(model, joints[0]) is not None
    legs, said = _legs(model, joints, limbs)
    if (free or leggy) and len(legs) in (2, 4):
        return ("humanoid" if len(legs) == 2 else "quadruped"), f"{len(legs)} limbs {said}"
    trunks = [*_parents(model, joints)[1].values()].count(0)  # moving bodies that hang on the base
    arms = any(_ARM.search(model.joint(joint).name) for joint in joints)
    if not free and not leggy and (len(limbs) == 1 or arms or trunks == 1):
        return "arm", "its base is fixed and nothing of it is a leg"
    raise RobotError(
        f"robots new: {source} does not say what it is: {len(limbs)} limbs, {len(down)} of them "
        f"reach the ground, {'a' if free else 'no'} free joint; give --kind, one of "
        f"{', '.join(KINDS)}"
    )


def _down(model: Any, joints: Joints, limbs: list[_Limb]) -> list[_Limb]:
    """Return the limbs that reach the ground."""
    own = model.body_rootid == model.body_rootid[model.jnt_bodyid[joints[0]]]
    low = min(limb.height for limb in limbs)
    near = low + _NEAR * (float(_heights(model)[own].max()) - low)
    return [limb for limb in limbs if limb.height <= near]


def _legs(model: Any, joints: Joints, limbs: list[_Limb]) -> tuple[list[_Limb], str]:
    """Return the legs, and what makes them such."""
    legs = [limb for limb in _down(model, joints, limbs) if len(limb.joints) > 1]
    if len(legs) in (2, 4):
        return legs, "reach the ground"
    return [limb for limb in limbs if limb.leggy], "are called as legs are"


def _endless(model: Any, joint: int) -> bool:
    hinge = int(import_mujoco().mjtJoint.mjJNT_HINGE)
    lower, upper = map(float, model.jnt_range[joint])
    wide = not model.jnt_limited[joint] or upper - lower > _TURNS
    return int(model.jnt_type[joint]) == hinge and wide


def _heights(model: Any) -> Float64:
    """Return the heights of all bodies in [m] with all joints at 0."""
    mujoco = import_mujoco()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return np.array(data.xpos[:, 2])


def _above(model: Any, body: int, moved: dict[int, list[int]]) -> int:
    """Return the nearest body with joints at or above a body, 0 where there is none."""
    while body and body not in moved:
        body = int(model.body_parentid[body])
    return body


def _parents(model: Any, joints: Joints) -> tuple[dict[int, list[int]], dict[int, int]]:
    """Return the joints of each body that has any, and the next such body above it, else 0."""
    moved: dict[int, list[int]] = {}
    for joint in joints:
        moved.setdefault(int(model.jnt_bodyid[joint]), []).append(joint)
    return moved, {body: _above(model, int(model.body_parentid[body]), moved) for body in moved}


def _limbs(model: Any, joints: Joints) -> list[_Limb]:
    moved, parents = _parents(model, joints)
    lowest: dict[int, float] = {}
    for body, height in enumerate(_heights(model).tolist()):
        owner = _above(model, body, moved)
        lowest[owner] = min(lowest.get(owner, height), height)
    above = list(parents.values())
    limbs = []
    for tip in moved:
        if tip in above:
            continue
        chain = [tip]
        while parents[chain[-1]] and above.count(parents[chain[-1]]) == 1:
            chain.append(parents[chain[-1]])
        own = [joint for body in chain for joint in reversed(moved[body])]
        names = [model.joint(joint).name for joint in own]
        others = [_endless(model, joint) for joint in own[1:]]
        limbs.append(
            _Limb(
                tuple(own),
                min(lowest[body] for body in chain),
                _endless(model, own[0]) and (not any(others) or bool(_WHEEL.search(names[0]))),
                any(map(_LEG.search, (*names, *(model.body(body).name for body in chain)))),
            )
        )
    return limbs


def feet_of(model: Any, legs: Sequence[Joints]) -> list[str]:
    """Return a name for the foot of each leg.

    Bodies, else sites, else geoms called feet, one for each leg; else geoms called by the corner;
    else the last bodies. A leg whose end has no name has no foot here.

    Args:
        model: an `MjModel`.
        legs: numbers of the joints of each, tip first.
    """
    owners = {
        "body": range(model.nbody),
        "site": model.site_bodyid.tolist(),
        "geom": model.geom_bodyid.tolist(),
    }
    ends = [_ends(model, int(model.jnt_bodyid[leg[0]])) for leg in legs]
    for kind, called in (("body", _FOOT), ("site", _FOOT), ("geom", _FOOT), ("geom", _CORNER)):
        names = [(getattr(model, kind)(i).name, owner) for i, owner in enumerate(owners[kind])]
        found = [
            [name for name, owner in names if owner in end and called.search(name)] for end in ends
        ]
        if all(len(each) == 1 or (each and kind == "body") for each in found):
            return [each[0] for each in found]
    return [name for end in ends if (name := model.body(min(end)).name)]


def _ends(model: Any, tip: int) -> set[int]:
    """Return a body and all below it."""
    ends = {tip}
    for body in range(tip + 1, model.nbody):  # parents come first
        if int(model.body_parentid[body]) in ends:
            ends.add(body)
    return ends
