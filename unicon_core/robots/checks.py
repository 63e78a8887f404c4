"""Checks of one value of a robot file, for the checks of its parts."""

from __future__ import annotations

import math
import re
from typing import Any

from unicon_core.errors import alternatives
from unicon_core.located_yaml import Located, Where
from unicon_core.robots.robot import JOINT_FIELDS

__all__ = ["check_keys", "check_name", "check_number", "check_text"]

_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_./:+-]*")
_NULLABLE = ("imu", "position", "quat", *JOINT_FIELDS)


def check_keys(
    located: Located,
    where: Where,
    mapping: dict[Any, Any],
    required: tuple[str, ...],
    optional: tuple[str, ...] = (),
) -> None:
    place = place_name(located, where)
    for key in mapping:
        if key not in required and key not in optional:
            known = alternatives(str(key), required + optional)
            raise located.error((*where, key), f"{place}unknown key {key!r}; {known}")
    for key in required:
        if key not in mapping:
            empty = "{} where there is none" if key == "models" else "null where not known"
            remedy = f"add it, {empty}" if key in ("models", *_NULLABLE) else "add it"
            raise located.error(where, f"{place}missing key {key!r}; {remedy}")


def place_name(located: Located, where: Where) -> str:
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


def check_text(located: Located, where: Where, value: Any) -> None:
    if not isinstance(value, str) or not value.strip():
        raise located.error(
            where, f"{place_name(located, where[:-1])}{where[-1]} is {_show(value)}; write a text"
        )


def check_name(located: Located, where: Where, value: Any) -> None:
    """The name of a joint or frame: it stands in URDF, TF and joint states as it is."""
    check_text(located, where, value)
    if len(value) > 255 or not _NAME.fullmatch(value):
        raise located.error(
            where,
            f"{place_name(located, where[:-1])}{where[-1]} {value[:60]!r} is no name; write "
            "letters, digits and _ . / : + -, the first a letter, a digit or _",
        )


def check_number(located: Located, where: Where, value: Any) -> None:
    """A finite number, or null."""
    if value is None:
        return
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise located.error(
            where,
            f"{place_name(located, where[:-1])}{where[-1]} is {_show(value)}; "
            f"write a number or null",
        )
