"""Checks a robot file with exact messages, for `load_robot`; the JSON Schema is for editors."""

from __future__ import annotations

import math
from typing import Any

from unicon_core.errors import alternatives
from unicon_core.located_yaml import Located, Where
from unicon_core.robots.robot import JOINT_FIELDS

__all__ = ["KINDS", "SCHEMA", "validate"]

SCHEMA = "unicon.robot/1"
KINDS = ("quadruped", "humanoid", "hand", "arm")

_REQUIRED = (
    "schema",
    "name",
    "description",
    "manufacturer",
    "kind",
    "model",
    "base_frame",
    "joints",
    "imu",
    "transport",
    "sources",
)
_OPTIONAL = ("feet", "fingertips", "unknown")
_JOINT_KEYS = ("name", *JOINT_FIELDS)
_IMU_KEYS = ("frame", "position", "quat")
_POSITIVE = ("velocity", "effort")
_NOT_NEGATIVE = ("stiffness", "damping")


def validate(located: Located) -> None:
    """Check a robot file, the first finding is raised.

    Raises:
        RobotError: `file:line: ` and the culprit, the alternatives and the remedy.
    """
    document = located.value
    if not isinstance(document, dict):
        raise located.error((), "a robot file is a mapping; begin with `schema: unicon.robot/1`")
    _keys(located, (), document, _REQUIRED, _OPTIONAL)
    if document["schema"] != SCHEMA:
        raise located.error(
            ("schema",), f"schema {document['schema']!r} is not known; write `schema: {SCHEMA}`"
        )
    for key in ("name", "description", "manufacturer", "base_frame"):
        _text(located, (key,), document[key])
    if document["name"] != located.path.stem:
        raise located.error(
            ("name",),
            f"name {document['name']!r} differs from the file's name; "
            f"write `name: {located.path.stem}` or rename the file",
        )
    if document["kind"] not in KINDS:
        raise located.error(
            ("kind",),
            f"kind {document['kind']!r} is not known; {alternatives(str(document['kind']), KINDS)}",
        )
    if document["model"] is not None:
        _text(located, ("model",), document["model"])
    _joints(located, document["joints"])
    _imu(located, document["imu"])
    _contacts(located, document)
    _transport(located, document["transport"])
    _unknown(located, document)
    _sources(located, document)


def _keys(
    located: Located,
    where: Where,
    mapping: dict[Any, Any],
    required: tuple[str, ...],
    optional: tuple[str, ...] = (),
) -> None:
    place = _name(located, where)
    for key in mapping:
        if key not in required and key not in optional:
            known = alternatives(str(key), required + optional)
            raise located.error((*where, key), f"{place}unknown key {key!r}; {known}")
    for key in required:
        if key not in mapping:
            remedy = "add it" if key in ("schema", "name") else "add it, null where not known"
            raise located.error(where, f"{place}missing key {key!r}; {remedy}")


def _name(located: Located, where: Where) -> str:
    """How a message calls a place: `joint 'FR_hip_joint': `, `imu: `, or nothing for the top."""
    if where[:1] == ("joints",) and len(where) > 1:
        joint = located.value["joints"][where[1]]
        name = joint.get("name") if isinstance(joint, dict) else None
        return f"joint {name!r}: " if isinstance(name, str) else f"joint number {where[1]}: "
    return f"{'.'.join(map(str, where))}: " if where else ""


def _text(located: Located, where: Where, value: Any) -> None:
    if not isinstance(value, str) or not value.strip():
        raise located.error(
            where, f"{_name(located, where[:-1])}{where[-1]} is {value!r}; write a text"
        )


def _number(located: Located, where: Where, value: Any) -> None:
    """A finite number, or null."""
    if value is None:
        return
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        hint = ""
        if isinstance(value, str) and "e" in value.lower():
            hint = " (YAML reads an exponent only with a point and a sign, such as 1.0e-3)"
        raise located.error(
            where,
            f"{_name(located, where[:-1])}{where[-1]} is {value!r}; write a number or null{hint}",
        )


def _joints(located: Located, joints: Any) -> None:
    if not isinstance(joints, list) or not joints:
        raise located.error(("joints",), "joints is no list; name each joint in motor order")
    seen: dict[str, int] = {}
    for i, joint in enumerate(joints):
        where: Where = ("joints", i)
        if not isinstance(joint, dict):
            raise located.error(
                where, f"joint number {i} is {joint!r}; write {{name: …, lower: …}}"
            )
        _keys(located, where, joint, _JOINT_KEYS)
        _text(located, (*where, "name"), joint["name"])
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
        _number(located, (*where, key), joint[key])
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
    for key in _NOT_NEGATIVE:
        if joint[key] is not None and joint[key] < 0:
            raise located.error(
                (*where, key), f"{name}: {key} {joint[key]} is negative; correct it"
            )


def _imu(located: Located, imu: Any) -> None:
    if imu is None:
        return
    if not isinstance(imu, dict):
        raise located.error(
            ("imu",), f"imu is {imu!r}; write {{frame: …, position: …, quat: …}} or null"
        )
    _keys(located, ("imu",), imu, _IMU_KEYS)
    _text(located, ("imu", "frame"), imu["frame"])
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
            _number(located, ("imu", key, i), number)
    if imu["quat"] is not None:
        norm = math.sqrt(sum(number * number for number in imu["quat"]))
        if abs(norm - 1.0) > 1e-3:
            raise located.error(
                ("imu", "quat"),
                f"imu: quat has length {norm:.4g}; write a unit quaternion, w first",
            )


def _contacts(located: Located, document: dict[str, Any]) -> None:
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


def _transport(located: Located, transport: Any) -> None:
    if not isinstance(transport, dict):
        raise located.error(("transport",), f"transport is {transport!r}; write {{protocol: …, …}}")
    if "protocol" not in transport:
        raise located.error(
            ("transport",), "transport: missing key 'protocol'; add it, null where not known"
        )
    if transport["protocol"] is not None:
        _text(located, ("transport", "protocol"), transport["protocol"])


def _nulls(document: dict[str, Any]) -> list[str]:
    """The dotted facts that a file leaves open and that its `unknown` has to name."""
    transport = document["transport"]
    walks = document["kind"] in ("quadruped", "humanoid")
    fields = [key for key in JOINT_FIELDS if any(j[key] is None for j in document["joints"])]
    if transport.get("command") == "position":
        # The vendor closes the loop: there are no gains to be found.
        fields = [key for key in fields if key not in ("stiffness", "damping")]
    nulls = [f"joints.{key}" for key in fields]
    if document["imu"] is None:
        nulls += ["imu"] if walks else []
    else:
        nulls += [f"imu.{key}" for key in _IMU_KEYS if document["imu"][key] is None]
    nulls += [key for key in ("feet", "fingertips") if document.get(key) == []]
    return nulls + [f"transport.{key}" for key, value in transport.items() if value is None]


def _unknown(located: Located, document: dict[str, Any]) -> None:
    unknown = document.get("unknown")
    if unknown is None:
        unknown = []
    if not isinstance(unknown, list) or not all(isinstance(fact, str) for fact in unknown):
        raise located.error(("unknown",), f"unknown is {unknown!r}; write a list of facts")
    nulls = _nulls(document)
    for fact in nulls:
        if fact not in unknown:
            raise located.error(
                _place(document, fact),
                f"{fact} has a null that 'unknown' does not name; add {fact!r} to unknown",
            )
    for i, fact in enumerate(unknown):
        if fact != "joint_order" and fact not in nulls:
            known = alternatives(fact, [*nulls, "joint_order"])
            raise located.error(
                ("unknown", i), f"unknown names {fact!r}, which is given or no fact; {known}"
            )
        if fact in unknown[:i]:
            raise located.error(("unknown", i), f"unknown names {fact!r} twice; remove one")


def _place(document: dict[str, Any], fact: str) -> Where:
    parts = fact.split(".", 1)
    if parts[0] == "joints":
        first = next(i for i, joint in enumerate(document["joints"]) if joint[parts[1]] is None)
        return ("joints", first, parts[1])
    return tuple(parts)


def _sources(located: Located, document: dict[str, Any]) -> None:
    """Every group of figures that the file gives says where it was taken from."""
    sources = document["sources"]
    if not isinstance(sources, dict):
        raise located.error(
            ("sources",), f"sources is {sources!r}; write one entry per group of facts"
        )
    for key, text in sources.items():
        _text(located, ("sources", key), text)
    joints = document["joints"]
    given = {
        "joints": True,
        "gains": any(j[key] is not None for j in joints for key in _NOT_NEGATIVE),
        "default": any(j["default"] is not None for j in joints),
        "rest": any(j["rest"] is not None for j in joints),
        "imu": document["imu"] is not None,
        "feet": bool(document.get("feet")),
        "fingertips": bool(document.get("fingertips")),
        "transport": True,
    }
    for group, needed in given.items():
        if needed and group not in sources:
            raise located.error(
                ("sources",),
                f"sources does not say where {group!r} was taken from; add `{group}: …`",
            )
