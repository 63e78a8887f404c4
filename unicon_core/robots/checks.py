"""Checks of a robot file's values, joints, IMU and contacts, for the validator.

Each yields what is wrong and goes on, so that a file's mistakes are told all at once.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from difflib import get_close_matches
from typing import Any

from unicon_core.bounds import DAMPING, EFFORT, POSITION, STIFFNESS, VELOCITY
from unicon_core.errors import UniconError, alternatives
from unicon_core.located_yaml import Located, Where
from unicon_core.robots.robot import JOINT_FIELDS, JOINT_ORDER

Problems = Iterator[UniconError]

COMMAND_AXES = ("vx", "vy", "wz")
IMU_KEYS = ("frame", "position", "quat")
NOT_NEGATIVE = ("stiffness", "damping")
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_./:+-]*")
_ENDLESS = ("lower", "upper")
_NULLABLE = ("imu", "position", "quat", *JOINT_FIELDS)
LARGEST = {
    **dict.fromkeys(("lower", "upper", "default", "rest"), POSITION),
    "velocity": VELOCITY,
    "effort": EFFORT,
    "stiffness": STIFFNESS,
    "damping": DAMPING,
}
"""Key to the largest plausible size of a joint's figure, in SI units."""


def wrong(located: Located, where: Where, finding: str) -> UniconError:
    """Return the error about a value: `file:line: `, what it is called, and what was found."""
    return located.error(where, f"{_place(located, where[:-1])}{where[-1]} {finding}")


def check_keys(
    located: Located,
    where: Where,
    mapping: dict[Any, Any],
    required: tuple[str, ...],
    optional: tuple[str, ...] = (),
) -> Problems:
    """Yield unknown and missing keys; a missing one that is misspelt is told once."""
    place = _place(located, where)
    misspelt = set()
    for key in mapping:
        if key not in required and key not in optional:
            misspelt.update(meant(key, required))
            known = alternatives(str(key), required + optional)
            known = JOINT_ORDER if key == "joint_order" else known
            yield located.error((*where, key), f"{place}unknown key {key!r}; {known}")
    for key in required:
        if key not in mapping and key not in misspelt:
            empty = "{} where there is none" if key == "models" else "null where not known"
            remedy = f"add it, {empty}" if key in ("models", *_NULLABLE) else "add it"
            yield located.error(where, f"{place}missing key {key!r}; {remedy}")


def meant(key: Any, known: Sequence[str]) -> list[str]:
    """Return the key that a misspelt, longer or shorter one stands for, if any."""
    word = str(key)[:80]
    alike = [other for other in known if word.startswith(other) or other.startswith(word)]
    return get_close_matches(word, known, n=1) or (alike if word else [])[:1]


def _place(located: Located, where: Where) -> str:
    """How a message calls a place: `joint 'FR_hip_joint': `, `imu: `, or nothing for the top."""
    if where[:1] == ("joints",) and len(where) > 1:
        joint = located.value["joints"][where[1]]
        name = joint.get("name") if isinstance(joint, dict) else None
        return f"joint {name!r}: " if isinstance(name, str) else f"joint number {where[1]}: "
    return f"{'.'.join(map(str, where))}: " if where else ""


def _show(value: Any) -> str:
    """A value in the words of YAML, not of Python."""
    return (
        "null" if value is None else str(value).lower() if isinstance(value, bool) else repr(value)
    )


def check_mapping(located: Located, where: Where, value: Any, remedy: str) -> Problems:
    if not isinstance(value, dict):
        yield wrong(located, where, f"is {value!r}; {remedy}")


def check_text(located: Located, where: Where, value: Any) -> Problems:
    if not isinstance(value, str) or not value.strip():
        yield wrong(located, where, f"is {_show(value)}; write a text")


def check_name(located: Located, where: Where, value: Any) -> Problems:
    """The name of a joint or frame: it stands in URDF, TF and joint states as it is."""
    if not isinstance(value, str) or not value.strip():
        yield from check_text(located, where, value)
    elif len(value) > 255 or not _NAME.fullmatch(value):
        yield wrong(
            located,
            where,
            f"{value[:60]!r} is not a name; write letters, digits and _ . / : + -, the first a "
            "letter, a digit or _",
        )


def _is_finite(value: Any) -> bool:
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return number and math.isfinite(value)


def check_number(located: Located, where: Where, value: Any) -> Problems:
    """A finite number, or null."""
    if value is not None and not _is_finite(value):
        yield wrong(located, where, f"is {_show(value)}; write a number or null")


def check_one_of(located: Located, where: Where, value: Any, known: tuple[str, ...]) -> Problems:
    if value not in known:
        yield wrong(located, where, f"{value!r} is not known; {alternatives(str(value), known)}")


def check_joints(located: Located, joints: Any) -> Problems:
    if not isinstance(joints, list) or not joints:
        yield wrong(located, ("joints",), "is not a list; name each joint in motor order")
        return
    seen: dict[str, int] = {}
    for i, joint in enumerate(joints):
        where: Where = ("joints", i)
        if not isinstance(joint, dict):
            yield located.error(
                where, f"joint number {i} is {joint!r}; write {{name: …, lower: …}}"
            )
            continue
        yield from check_keys(located, where, joint, ("name", *JOINT_FIELDS))
        yield from _joint(located, where, joint)
        name = joint.get("name")
        if "name" in joint:
            yield from check_name(located, (*where, "name"), name)
        if not isinstance(name, str):
            continue
        if name in seen:
            yield located.error(
                (*where, "name"),
                f"joint {name!r} stands twice, as number {seen[name]} and {i}; "
                "name each joint once",
            )
        seen.setdefault(name, i)


def _endless(joint: dict[str, Any]) -> bool:
    """Whether a joint says that it turns without end, as a wheel does."""
    return (joint.get("lower"), joint.get("upper")) == (-math.inf, math.inf)


def _joint(located: Located, where: Where, joint: dict[str, Any]) -> Problems:
    def bad(key: str, finding: str) -> UniconError:
        return wrong(located, (*where, key), f"{joint[key]} {finding}")

    given: dict[str, float] = {}
    for key in JOINT_FIELDS:
        figure = joint.get(key)
        if figure is None or (key in _ENDLESS and _endless(joint)):
            continue
        if not _is_finite(figure):
            yield from check_number(located, (*where, key), figure)
        elif abs(figure) > LARGEST[key]:
            yield wrong(
                located,
                (*where, key),
                f"{figure!r:.20} is beyond ±{LARGEST[key]:.4g}, the largest plausible figure "
                "in SI units; correct it, or write null if not known",
            )
        else:
            given[key] = figure
    lower, upper = given.get("lower", -math.inf), given.get("upper", math.inf)
    if lower >= upper:
        yield bad("lower", f"is not below upper {upper}; swap or correct them")
        lower, upper = -math.inf, math.inf  # what lies outside them is not told as well
    for key in ("default", "rest"):
        if key in given and not lower <= given[key] <= upper:
            limits = f"[{joint.get('lower')}, {joint.get('upper')}]"
            yield bad(key, f"is outside its limits {limits}; correct the pose or the limits")
    for key in ("velocity", "effort"):
        if key in given and given[key] <= 0:
            yield bad(key, "is not above 0; write null if not known")
    for key in NOT_NEGATIVE:
        if key in given and given[key] < 0:
            yield bad(key, "is negative; correct it")


def check_imu(located: Located, imu: Any) -> Problems:
    if imu is None:
        return
    if not isinstance(imu, dict):
        remedy = "write {frame: …, position: …, quat: …} or null"
        yield from check_mapping(located, ("imu",), imu, remedy)
        return
    yield from check_keys(located, ("imu",), imu, IMU_KEYS)
    if "frame" in imu:
        yield from check_name(located, ("imu", "frame"), imu["frame"])
    for key, length in (("position", 3), ("quat", 4)):
        value, remedy = imu.get(key), f"write {length} numbers or null"
        if value is None:
            continue
        if not isinstance(value, list) or len(value) != length:
            got = f"{len(value)} values" if isinstance(value, list) else repr(value)
            yield wrong(located, ("imu", key), f"has {got}; {remedy}")
        elif None in value:
            yield wrong(located, ("imu", key), f"has a null; {remedy}")
        elif not all(map(_is_finite, value)):
            for i, number in enumerate(value):
                yield from check_number(located, ("imu", key, i), number)
        elif key == "quat" and abs(math.hypot(*value) - 1.0) > 1e-3:
            yield wrong(
                located,
                ("imu", "quat"),
                f"has length {math.hypot(*value):.4g}; write a unit quaternion, w first",
            )


def check_contacts(located: Located, document: dict[str, Any]) -> Problems:
    """Feet of a robot that walks, fingertips of a hand: a list of names, empty where not known."""
    kind = document["kind"]
    key = {"quadruped": "feet", "humanoid": "feet", "hand": "fingertips"}.get(kind)
    instead = [other for other in document if key and key in meant(other, (key,))]
    for other in ("feet", "fingertips"):
        if other in document and other != key:
            instead.append(other)
            remedy = f"write {key!r}" if key else "remove it"
            yield located.error((other,), f"a robot of kind {kind} has no {other!r}; {remedy}")
    if key is None:
        return
    if key not in document:
        if not instead:
            yield located.error((), f"missing key {key!r}; add it, [] where not known")
        return
    names = document[key]
    if not isinstance(names, list) or not all(isinstance(n, str) and n for n in names):
        yield wrong(located, (key,), f"is {names!r}; write a list of names")
        return
    for name in sorted({name for name in names if names.count(name) > 1}):
        yield located.error((key,), f"{key}: {name!r} stands twice; name each once")


def check_command_ranges(located: Located, ranges: Any) -> Problems:
    """`{vx: [lowest, highest], …}`, zero within; whatever is left out is not known."""
    if ranges is None:
        return
    if not isinstance(ranges, dict):
        remedy = "write {vx: [lowest, highest], vy: …, wz: …}"
        yield from check_mapping(located, ("command_ranges",), ranges, remedy)
        return
    yield from check_keys(located, ("command_ranges",), ranges, (), COMMAND_AXES)
    for axis, pair in ranges.items():
        numbers = isinstance(pair, list) and all(map(_is_finite, pair))
        if axis not in COMMAND_AXES:
            continue
        if not numbers or len(pair) != 2 or not pair[0] <= 0.0 <= pair[1]:
            yield wrong(
                located,
                ("command_ranges", axis),
                f"is {pair!r}; write [lowest, highest] with 0 between them",
            )
