"""Checks robot files and overlays with exact messages, for `load_robot`.

The JSON Schema is for editors.
"""

from __future__ import annotations

from pathlib import PurePath
from typing import Any

from unicon_core.errors import alternatives
from unicon_core.located_yaml import Located, Where
from unicon_core.robots.checks import (
    IMU_KEYS,
    NOT_NEGATIVE,
    check_command_ranges,
    check_contacts,
    check_imu,
    check_joints,
    check_keys,
    check_mapping,
    check_name,
    check_number,
    check_text,
    wrong,
)
from unicon_core.robots.joint_physics import wrong_physics
from unicon_core.robots.robot import JOINT_FIELDS, MODEL_FORMATS

__all__ = ["COMMANDS", "KINDS", "SCHEMA", "is_overlay", "validate", "validate_overlay"]

SCHEMA = "unicon.robot/1"
KINDS = ("quadruped", "humanoid", "hand", "arm")
# position: the vendor closes the loop, so that there are no gains to give.
COMMANDS = ("position", "torque")

_REQUIRED = (
    "schema",
    "name",
    "description",
    "manufacturer",
    "kind",
    "models",
    "base_frame",
    "joints",
    "imu",
    "transport",
    "sources",
)
_OPTIONAL = ("feet", "fingertips", "command_ranges", "simulated", "unknown")
_OVERLAY = ("schema", "extends", "simulated")


def validate(located: Located) -> None:
    """Check a robot file, the first finding is raised.

    Raises:
        RobotError: `file:line: ` and the culprit, the alternatives and the remedy.
    """
    document = located.value
    if not isinstance(document, dict):
        raise located.error((), "a robot file is a mapping; begin with `schema: unicon.robot/1`")
    check_keys(located, (), document, _REQUIRED, _OPTIONAL)
    _schema(located, document)
    for key in ("name", "description", "manufacturer"):
        check_text(located, (key,), document[key])
    check_name(located, ("base_frame",), document["base_frame"])
    if document["name"] != located.path.stem:
        raise wrong(
            located,
            ("name",),
            f"{document['name']!r} differs from the file's name; "
            f"write `name: {located.path.stem}` or rename the file",
        )
    _one_of(located, ("kind",), document["kind"], KINDS)
    _models(located, document["models"])
    check_joints(located, document["joints"])
    check_imu(located, document["imu"])
    check_contacts(located, document)
    check_command_ranges(located, document.get("command_ranges"))
    _transport(located, document["transport"])
    _simulated(located, document.get("simulated"))
    _unknown(located, document)
    _sources(located, document)


def is_overlay(located: Located) -> bool:
    """Return whether a file says only what another robot file does not: it `extends` it."""
    return isinstance(located.value, dict) and "extends" in located.value


def validate_overlay(located: Located) -> None:
    """Check an overlay: `extends` and `simulated`; the first finding is raised.

    Raises:
        RobotError: `file:line: ` and the culprit, the alternatives and the remedy.
    """
    document = located.value
    check_keys(located, (), document, _OVERLAY, ("description",))
    _schema(located, document)
    check_text(located, ("extends",), document["extends"])
    if document.get("description") is not None:
        check_text(located, ("description",), document["description"])
    _simulated(located, document["simulated"])


def _schema(located: Located, document: dict[str, Any]) -> None:
    if document["schema"] != SCHEMA:
        raise wrong(
            located, ("schema",), f"{document['schema']!r} is not known; write `schema: {SCHEMA}`"
        )


def _simulated(located: Located, simulated: Any) -> None:
    found = None if simulated is None else wrong_physics(simulated)
    if found is not None:
        raise located.error(("simulated",), f"simulated: {found}")


def _one_of(located: Located, where: Where, value: Any, known: tuple[str, ...]) -> None:
    if value not in known:
        raise wrong(located, where, f"{value!r} is not known; {alternatives(str(value), known)}")


def _models(located: Located, models: Any) -> None:
    """Paths below the file's folder or a configuration folder; a workflow may name any."""
    remedy = "write {mjcf: PATH, urdf: PATH}, {} where there is none"
    check_mapping(located, ("models",), models, remedy)
    check_keys(located, ("models",), models, (), MODEL_FORMATS)
    for kind, model in models.items():
        check_text(located, ("models", kind), model)
        path = PurePath(model.removeprefix("assets:"))
        if path.is_absolute() or ".." in path.parts or model.startswith("~"):
            raise wrong(
                located,
                ("models", kind),
                f"{model!r} leads out of its folder; put it beside the robot file, or let the "
                "workflow name it: scene: {model: PATH}",
            )
        if path.suffix and (path.suffix.lower() == ".urdf") != (kind == "urdf"):
            other = "mjcf" if kind == "urdf" else "urdf"
            raise wrong(located, ("models", kind), f"{model!r} does not look so; write {other}: …")


def _transport(located: Located, transport: Any) -> None:
    check_mapping(located, ("transport",), transport, "write {protocol: …, …}")
    if "protocol" not in transport:
        raise located.error(
            ("transport",), "transport: missing key 'protocol'; add it, null where not known"
        )
    if transport["protocol"] is not None:
        check_text(located, ("transport", "protocol"), transport["protocol"])
    _one_of(located, ("transport", "command"), transport.get("command", "torque"), COMMANDS)
    _finite(located, ("transport",), transport)
    motors = transport.get("motors")
    numbers = isinstance(motors, list) and all(type(n) is int and n >= 0 for n in motors)
    if motors is not None and not numbers:
        raise wrong(
            located,
            ("transport", "motors"),
            f"is {str(motors)[:60]}; write the motor number of each joint, or null if not known",
        )
    rate = transport.get("rate_hz")
    check_number(located, ("transport", "rate_hz"), rate)
    if rate is not None and rate <= 0:
        raise wrong(
            located, ("transport", "rate_hz"), f"{rate} is not above 0; write null if not known"
        )


def _finite(located: Located, where: Where, value: Any) -> None:
    """No figure of a transport is NaN or infinite, however deep: it would go to the motors."""
    if isinstance(value, dict):
        for key, part in value.items():
            _finite(located, (*where, key), part)
    elif isinstance(value, list):
        for i, part in enumerate(value):
            _finite(located, (*where, i), part)
    elif isinstance(value, float):
        check_number(located, where, value)


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
        nulls += [f"imu.{key}" for key in IMU_KEYS if document["imu"][key] is None]
    nulls += [key for key in ("feet", "fingertips") if document.get(key) == []]
    return nulls + [f"transport.{key}" for key, value in transport.items() if value is None]


def _unknown(located: Located, document: dict[str, Any]) -> None:
    unknown = document.get("unknown")
    if unknown is None:
        unknown = []
    if not isinstance(unknown, list) or not all(isinstance(fact, str) for fact in unknown):
        raise wrong(located, ("unknown",), f"is {unknown!r}; write a list of facts")
    nulls = _nulls(document)
    for fact in nulls:
        if fact not in unknown:
            raise located.error(
                _place(document, fact),
                f"{fact} is not given, and 'unknown' does not name it; add {fact!r} to unknown",
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
    check_mapping(located, ("sources",), sources, "write one entry per group of facts")
    for key, text in sources.items():
        if not isinstance(key, str):
            raise located.error(("sources", key), f"sources: {key!r} is no group; write a word")
        check_text(located, ("sources", key), text)
    joints = document["joints"]
    given = {
        "joints": True,
        "gains": any(j[key] is not None for j in joints for key in NOT_NEGATIVE),
        "default": any(j["default"] is not None for j in joints),
        "rest": any(j["rest"] is not None for j in joints),
        "imu": document["imu"] is not None,
        "feet": bool(document.get("feet")),
        "fingertips": bool(document.get("fingertips")),
        "command_ranges": bool(document.get("command_ranges")),
        "transport": True,
    }
    for group, needed in given.items():
        if needed and group not in sources:
            raise located.error(
                ("sources",),
                f"sources does not say where {group!r} was taken from; add `{group}: …`",
            )
