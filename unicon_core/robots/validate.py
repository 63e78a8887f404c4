"""Checks robot files and overlays with exact messages, for `load_robot`.

The JSON Schema is for editors.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from fnmatch import fnmatchcase
from typing import Any

from unicon_core.errors import RobotFileError, UniconError, alternatives
from unicon_core.located_yaml import Located, Where
from unicon_core.robots.capsules import wrong_capsules
from unicon_core.robots.checks import (
    IMU_KEYS,
    NOT_NEGATIVE,
    Problems,
    check_command_ranges,
    check_contacts,
    check_imu,
    check_joints,
    check_keys,
    check_mapping,
    check_name,
    check_one_of,
    check_text,
    wrong,
)
from unicon_core.robots.hand import wrong_hand
from unicon_core.robots.joint_physics import wrong_physics
from unicon_core.robots.places import wrong_places
from unicon_core.robots.robot import JOINT_FIELDS
from unicon_core.robots.transport_checks import check_models, check_transport

SCHEMA = "unicon.robot/1"
KINDS = ("quadruped", "humanoid", "wheeled", "hand", "arm")

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
_OPTIONAL = (
    *("feet", "fingertips", "command_ranges", "groups", "mounts", "end_effectors", "capsules"),
    *("hand", "simulated", "unknown"),
)
_OVERLAY = ("schema", "extends", "simulated")


def validate(located: Located) -> None:
    """Check a robot file; all that is found is raised at once, in the order of its lines.

    Raises:
        RobotError: `file:line: ` and the culprit, the alternatives and the remedy; of several
            mistakes a `RobotFileError`.
    """
    refuse(located, _problems(located))


def _problems(located: Located) -> Problems:
    document = located.value
    if not isinstance(document, dict):
        yield located.error((), "a robot file is a mapping; begin with `schema: unicon.robot/1`")
        return
    yield from check_keys(located, (), document, _REQUIRED, _OPTIONAL)
    for key, check in _CHECKS.items():
        if key in document:
            yield from check(located, document[key])
    if document.get("kind") in KINDS:
        yield from check_contacts(located, document)
    yield from _unknown(located, document)
    yield from _sources(located, document)


def refuse(located: Located, problems: Iterable[UniconError]) -> None:
    """Raise what was found in a file, if anything; one in another version is told that alone."""
    found = list(problems)
    if found and _is_of_another_schema(located.value):
        found = list(_schema(located, located.value["schema"]))
    if len(found) == 1:
        raise found[0]
    if found:
        raise RobotFileError(located.path, sorted(found, key=_line))


def _line(problem: UniconError) -> int:
    return int((problem.where or ":0").rpartition(":")[2])


def _is_of_another_schema(document: Any) -> bool:
    return isinstance(document, dict) and document.get("schema", SCHEMA) != SCHEMA


def is_overlay(located: Located) -> bool:
    """Return whether a file says only what another robot file does not: it `extends` it."""
    return isinstance(located.value, dict) and "extends" in located.value


def validate_overlay(located: Located) -> None:
    """Check an overlay: `extends` and `simulated`; all that is found is raised at once.

    Raises:
        RobotError: as of `validate`.
    """
    refuse(located, _overlay_problems(located))


def _overlay_problems(located: Located) -> Problems:
    document = located.value
    yield from check_keys(located, (), document, _OVERLAY, ("description",))
    yield from check_text(located, ("extends",), document["extends"])
    if document.get("description") is not None:
        yield from check_text(located, ("description",), document["description"])
    for key, check in (("schema", _schema), ("simulated", _simulated)):
        if key in document:
            yield from check(located, document[key])


def _text(key: str) -> Check:
    return lambda located, value: check_text(located, (key,), value)


def _schema(located: Located, schema: Any) -> Problems:
    if schema != SCHEMA:
        yield wrong(located, ("schema",), f"{schema!r} is not known; write `schema: {SCHEMA}`")


def _name(located: Located, name: Any) -> Problems:
    if not isinstance(name, str) or not name.strip():
        yield from check_text(located, ("name",), name)
    elif name != located.path.stem:
        yield wrong(
            located,
            ("name",),
            f"{name!r} differs from the file's name; "
            f"write `name: {located.path.stem}` or rename the file",
        )


def _kind(located: Located, kind: Any) -> Problems:
    yield from check_one_of(located, ("kind",), kind, KINDS)


def _base_frame(located: Located, frame: Any) -> Problems:
    yield from check_name(located, ("base_frame",), frame)


def _simulated(located: Located, simulated: Any) -> Problems:
    if simulated is None:
        return
    if not isinstance(simulated, dict):
        yield located.error(("simulated",), f"simulated: {wrong_physics(simulated)}")
        return
    for joint, figures in simulated.items():
        each: list[tuple[Where, Any]] = [(("simulated", joint), figures)]
        if isinstance(figures, dict):
            each = [(("simulated", joint, w), {w: figure}) for w, figure in figures.items()]
        for where, said in each:
            found = wrong_physics({joint: said})
            if found is not None:
                yield located.error(where, f"simulated: {found}")


def _groups(located: Located, groups: Any) -> Problems:
    """`{legs: ["*_hip_*", …]}`: each pattern means a joint."""
    if groups is None:
        return
    if not isinstance(groups, dict):
        remedy = 'write {legs: ["*_hip_*", "*_knee_*"], …}'
        yield from check_mapping(located, ("groups",), groups, remedy)
        return
    names = [str(joint.get("name")) for joint in _joints(located.value)]
    for group, patterns in groups.items():
        where: Where = ("groups", group)
        if not isinstance(group, str) or not group.isidentifier() or group in names:
            yield located.error(
                where, f"groups: {group!r} is not a name for joints; use letters, digits and _"
            )
        if not isinstance(patterns, list) or not patterns:
            yield wrong(located, where, f"is {patterns!r}; write a list of joints or patterns")
            continue
        for i, pattern in enumerate(patterns):
            if not isinstance(pattern, str) or not any(fnmatchcase(n, pattern) for n in names):
                known = alternatives(str(pattern), names)
                yield located.error((*where, i), f"groups: no joint is like {pattern!r}; {known}")


def _placed(key: str, wrong_ones: Callable[[Any], Iterable[tuple[Where, str]]]) -> Check:
    def check(located: Located, said: Any) -> Problems:
        for where, found in wrong_ones(said) if said is not None else ():
            place: Where = (key, *where)
            yield located.error(place, f"{'.'.join(map(str, place))} {found}")

    return check


def _hand(located: Located, said: Any) -> Problems:
    kind = located.value.get("kind")
    if said is not None and kind in KINDS and kind != "hand":
        yield located.error(("hand",), f"a robot of kind {kind} has no 'hand'; remove it")
    else:
        yield from _placed("hand", wrong_hand)(located, said)


Check = Callable[[Located, Any], Problems]

_CHECKS: dict[str, Check] = {
    "schema": _schema,
    "name": _name,
    "description": _text("description"),
    "manufacturer": _text("manufacturer"),
    "kind": _kind,
    "models": check_models,
    "base_frame": _base_frame,
    "joints": check_joints,
    "imu": check_imu,
    "command_ranges": check_command_ranges,
    "transport": check_transport,
    "mounts": _placed("mounts", wrong_places),
    "end_effectors": _placed("end_effectors", wrong_places),
    "capsules": _placed("capsules", wrong_capsules),
    "hand": _hand,
    "simulated": _simulated,
    "groups": _groups,
}
"""Key to the check of its value, where it stands."""


def _joints(document: dict[str, Any]) -> list[dict[str, Any]]:
    joints = document.get("joints")
    return [j for j in joints if isinstance(j, dict)] if isinstance(joints, list) else []


def _nulls(document: dict[str, Any]) -> list[str]:
    """The dotted facts that a file leaves open and that its `unknown` has to name."""
    transport = document.get("transport")
    transport = transport if isinstance(transport, dict) else {}
    joints, imu = _joints(document), document.get("imu")
    fields = [key for key in JOINT_FIELDS if any(j.get(key, 0) is None for j in joints)]
    if transport.get("command") == "position":
        # The vendor closes the loop: there are no gains to be found.
        fields = [key for key in fields if key not in ("stiffness", "damping")]
    nulls = [f"joints.{key}" for key in fields]
    if "imu" in document and imu is None:
        nulls += ["imu"] if document.get("kind") in ("quadruped", "humanoid") else []
    elif isinstance(imu, dict):
        nulls += [f"imu.{key}" for key in IMU_KEYS if imu.get(key, 0) is None]
    nulls += [key for key in ("feet", "fingertips") if document.get(key) == []]
    return nulls + [f"transport.{key}" for key, value in transport.items() if value is None]


def _unknown(located: Located, document: dict[str, Any]) -> Problems:
    unknown = document.get("unknown")
    if unknown is None:
        unknown = []
    if not isinstance(unknown, list) or not all(isinstance(fact, str) for fact in unknown):
        yield wrong(located, ("unknown",), f"is {unknown!r}; write a list of facts")
        return
    nulls = _nulls(document)
    for i, fact in enumerate(unknown):
        if fact != "joint_order" and fact not in nulls:
            why = f"is no fact; {alternatives(fact, [*nulls, 'joint_order'])}"
            if _given(document, fact):
                why = "is given now: take it from unknown"
            yield located.error(("unknown", i), f"unknown names {fact!r}, which {why}")
        if fact in unknown[:i]:
            yield located.error(("unknown", i), f"unknown names {fact!r} twice; remove one")
    for fact in nulls:
        if fact not in unknown:
            yield located.error(
                _place(document, fact),
                f"{fact} is not given, and 'unknown' does not name it; add {fact!r} to unknown",
            )


def _given(document: dict[str, Any], fact: str) -> bool:
    part, _, key = fact.partition(".")
    if part == "joints":
        return key in JOINT_FIELDS and any(j.get(key) is not None for j in _joints(document))
    if not key:
        return part in ("imu", "feet", "fingertips") and bool(document.get(part))
    value = document.get(part) if part in ("imu", "transport") else None
    return isinstance(value, dict) and value.get(key) is not None


def _place(document: dict[str, Any], fact: str) -> Where:
    part, _, key = fact.partition(".")
    if part == "joints":
        all_joints = enumerate(document["joints"])
        first = next(i for i, j in all_joints if isinstance(j, dict) and j.get(key, 0) is None)
        return ("joints", first, key)
    return (part, key) if key else (part,)


def _sources(located: Located, document: dict[str, Any]) -> Problems:
    """Every group of figures that the file gives says where it was taken from."""
    if "sources" not in document:
        return
    sources = document["sources"]
    if not isinstance(sources, dict):
        yield from check_mapping(
            located, ("sources",), sources, "write one entry per group of facts"
        )
        return
    for key, text in sources.items():
        if not isinstance(key, str):
            yield located.error(("sources", key), f"sources: {key!r} is not a group; write a word")
        else:
            yield from check_text(located, ("sources", key), text)
    joints = _joints(document)
    given = {
        "joints": True,
        "gains": any(j.get(key) is not None for j in joints for key in NOT_NEGATIVE),
        "default": any(j.get("default") is not None for j in joints),
        "rest": any(j.get("rest") is not None for j in joints),
        "imu": document.get("imu") is not None,
        "feet": bool(document.get("feet")),
        "fingertips": bool(document.get("fingertips")),
        "command_ranges": bool(document.get("command_ranges")),
        "mounts": bool(document.get("mounts")),
        "end_effectors": bool(document.get("end_effectors")),
        "capsules": bool(document.get("capsules")),
        "hand": bool(document.get("hand")),
        "transport": True,
    }
    for group, needed in given.items():
        if needed and group not in sources:
            yield located.error(
                ("sources",),
                f"sources does not say where {group!r} was taken from; add `{group}: …`",
            )
