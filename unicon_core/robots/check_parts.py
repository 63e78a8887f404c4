"""Checks of a robot file's joints, IMU and contacts, for the validator."""

from __future__ import annotations

import math
from typing import Any

from unicon_core.bounds import DAMPING, EFFORT, POSITION, STIFFNESS, VELOCITY
from unicon_core.located_yaml import Located, Where
from unicon_core.robots.checks import check_keys, check_name, check_number
from unicon_core.robots.robot import JOINT_FIELDS

__all__ = [
    "IMU_KEYS",
    "NOT_NEGATIVE",
    "check_command_ranges",
    "check_contacts",
    "check_imu",
    "check_joints",
]

COMMAND_AXES = ("vx", "vy", "wz")

IMU_KEYS = ("frame", "position", "quat")
NOT_NEGATIVE = ("stiffness", "damping")
_JOINT_KEYS = ("name", *JOINT_FIELDS)
_POSITIVE = ("velocity", "effort")
# The largest plausible size of each figure of a joint.
_LARGEST = {
    **dict.fromkeys(("lower", "upper", "default", "rest"), POSITION),
    "velocity": VELOCITY,
    "effort": EFFORT,
    "stiffness": STIFFNESS,
    "damping": DAMPING,
}


def check_joints(located: Located, joints: Any) -> None:
    if not isinstance(joints, list) or not joints:
        raise located.error(("joints",), "joints is no list; name each joint in motor order")
    seen: dict[str, int] = {}
    for i, joint in enumerate(joints):
        where: Where = ("joints", i)
        if not isinstance(joint, dict):
            raise located.error(
                where, f"joint number {i} is {joint!r}; write {{name: …, lower: …}}"
            )
        check_keys(located, where, joint, _JOINT_KEYS)
        check_name(located, (*where, "name"), joint["name"])
        if joint["name"] in seen:
            raise located.error(
                (*where, "name"),
                f"joint {joint['name']!r} stands twice, as number {seen[joint['name']]} and {i}; "
                "name each joint once",
            )
        seen[joint["name"]] = i
        _joint(located, where, joint)


def _joint(located: Located, where: Where, joint: dict[str, Any]) -> None:
    name = f"joint {joint['name']!r}"
    for key in JOINT_FIELDS:
        check_number(located, (*where, key), joint[key])
        if joint[key] is not None and abs(joint[key]) > _LARGEST[key]:
            raise located.error(
                (*where, key),
                f"{name}: {key} {joint[key]!r:.20} is beyond ±{_LARGEST[key]:.4g}, the largest "
                "plausible figure in SI units; correct it, or write null if not known",
            )
    lower, upper = joint["lower"], joint["upper"]
    if lower is not None and upper is not None and lower >= upper:
        raise located.error(
            (*where, "lower"),
            f"{name}: lower {lower} is not below upper {upper}; swap or correct them",
        )
    for key in ("default", "rest"):
        value = joint[key]
        outside = value is not None and (
            (lower is not None and value < lower) or (upper is not None and value > upper)
        )
        if outside:
            raise located.error(
                (*where, key),
                f"{name}: {key} {value} is outside its limits [{lower}, {upper}]; "
                "correct the pose or the limits",
            )
    for key in _POSITIVE:
        if joint[key] is not None and joint[key] <= 0:
            raise located.error(
                (*where, key), f"{name}: {key} {joint[key]} is not above 0; write null if not known"
            )
    for key in NOT_NEGATIVE:
        if joint[key] is not None and joint[key] < 0:
            raise located.error(
                (*where, key), f"{name}: {key} {joint[key]} is negative; correct it"
            )


def check_imu(located: Located, imu: Any) -> None:
    if imu is None:
        return
    if not isinstance(imu, dict):
        raise located.error(
            ("imu",), f"imu is {imu!r}; write {{frame: …, position: …, quat: …}} or null"
        )
    check_keys(located, ("imu",), imu, IMU_KEYS)
    check_name(located, ("imu", "frame"), imu["frame"])
    for key, length in (("position", 3), ("quat", 4)):
        value = imu[key]
        if value is None:
            continue
        if not isinstance(value, list) or len(value) != length:
            got = f"{len(value)} values" if isinstance(value, list) else repr(value)
            raise located.error(
                ("imu", key), f"imu: {key} has {got}; write {length} numbers or null"
            )
        for i, number in enumerate(value):
            if number is None:
                raise located.error(
                    ("imu", key), f"imu: {key} has a null; write {length} numbers or null"
                )
            check_number(located, ("imu", key, i), number)
    if imu["quat"] is not None:
        norm = math.sqrt(sum(number * number for number in imu["quat"]))
        if abs(norm - 1.0) > 1e-3:
            raise located.error(
                ("imu", "quat"),
                f"imu: quat has length {norm:.4g}; write a unit quaternion, w first",
            )


def check_contacts(located: Located, document: dict[str, Any]) -> None:
    """Feet of a robot that walks, fingertips of a hand: a list of names, empty where not known."""
    kind = document["kind"]
    key = {"quadruped": "feet", "humanoid": "feet", "hand": "fingertips"}.get(kind)
    for other in ("feet", "fingertips"):
        if other in document and other != key:
            remedy = f"write {key!r}" if key else "remove it"
            raise located.error((other,), f"a robot of kind {kind} has no {other!r}; {remedy}")
    if key is None:
        return
    if key not in document:
        raise located.error((), f"missing key {key!r}; add it, [] where not known")
    names = document[key]
    if not isinstance(names, list) or not all(isinstance(n, str) and n for n in names):
        raise located.error((key,), f"{key} is {names!r}; write a list of names")
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise located.error((key,), f"{key}: {twice[0]!r} stands twice; name each once")


def check_command_ranges(located: Located, ranges: Any) -> None:
    """`{vx: [lowest, highest], …}`, zero within; whatever is left out is not known."""
    if ranges is None:
        return
    if not isinstance(ranges, dict):
        raise located.error(
            ("command_ranges",),
            f"command_ranges is {ranges!r}; write {{vx: [lowest, highest], vy: …, wz: …}}",
        )
    check_keys(located, ("command_ranges",), ranges, (), COMMAND_AXES)
    for axis, pair in ranges.items():
        numbers = isinstance(pair, list) and all(
            isinstance(v, (int, float)) and not isinstance(v, bool) and math.isfinite(v)
            for v in pair
        )
        if not numbers or len(pair) != 2 or not pair[0] <= 0.0 <= pair[1]:
            raise located.error(
                ("command_ranges", axis),
                f"command_ranges: {axis} is {pair!r}; write [lowest, highest] with 0 between them",
            )
