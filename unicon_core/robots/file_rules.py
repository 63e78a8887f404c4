"""Rules between the keys of a robot file: joints, contacts, groups, unknown facts and sources."""

from __future__ import annotations

from collections.abc import Mapping
from fnmatch import fnmatchcase

from unicon_base import AnyDict, AnyMapping, alternatives
from unicon_base.located_yaml import Where
from unicon_base.schema.records import meant
from unicon_base.schema.types import Here
from unicon_core.robots.robot import JOINT_FIELDS


def joints_of(document: AnyMapping) -> list[AnyDict]:
    joints = document.get("joints")
    return [j for j in joints if isinstance(j, dict)] if isinstance(joints, list) else []


def note_joints_once(document: AnyMapping, here: Here) -> None:
    joints = document.get("joints")
    seen: dict[str, int] = {}
    for i, joint in enumerate(joints if isinstance(joints, list) else ()):
        name = joint.get("name") if isinstance(joint, dict) else None
        if isinstance(name, str) and seen.setdefault(name, i) != i:
            here.note(
                f"joint {name!r} stands twice, as number {seen[name]} and {i}; name each once",
                *("joints", i, "name"),
            )


def note_contacts(kind: str, document: AnyMapping, here: Here) -> None:
    """Note feet of what does not walk, fingertips of what is no hand, and missing ones."""
    key = {"quadruped": "feet", "humanoid": "feet", "hand": "fingertips"}.get(kind)
    instead = [other for other in document if key and key in meant(other, (key,))]
    for other in ("feet", "fingertips"):
        if other in document and other != key:
            instead.append(other)
            remedy = f"write {key!r}" if key else "remove it"
            here.note(f"a robot of kind {kind} has no {other!r}; {remedy}", other)
    if key is not None and key not in document and not instead:
        here.note(f"missing key {key!r}; add it, [] where not known")
    names = document.get(key or "")
    listed = names if isinstance(names, list) else []
    for name in listed:
        if listed.count(name) > 1:
            here.note(f"{key}: {name!r} stands twice; name each once", key or "")
            break
    if document.get("hand") is not None and kind != "hand":
        here.note(f"a robot of kind {kind} has no 'hand'; remove it", "hand")


def note_groups(groups: Mapping[str, list[str]], document: AnyMapping, here: Here) -> None:
    names = [str(joint.get("name")) for joint in joints_of(document)]
    for group, patterns in groups.items():
        if not group.isidentifier() or group in names:
            text = f"groups: {group!r} is not a name for joints; use letters, digits and _"
            here.note(text, "groups", group)
        for i, pattern in enumerate(patterns):
            if not any(fnmatchcase(name, pattern) for name in names):
                known = alternatives(pattern, names)
                here.note(f"groups: no joint is like {pattern!r}; {known}", "groups", group, i)


def _nulls(document: AnyMapping) -> dict[str, Where]:
    """Return the dotted facts that a file leaves open and that its `unknown` has to name.

    Each has the place where it is left open first.
    """
    transport = document.get("transport")
    transport = transport if isinstance(transport, dict) else {}
    joints, imu = document.get("joints"), document.get("imu")
    # Where the vendor closes the loop, there are no gains to be found.
    closed = ("stiffness", "damping") if transport.get("command") == "position" else ()
    found: dict[str, Where] = {}
    for key in [key for key in JOINT_FIELDS if key not in closed]:
        for i, joint in enumerate(joints if isinstance(joints, list) else ()):
            if isinstance(joint, dict) and joint.get(key, 0) is None:
                found.setdefault(f"joints.{key}", ("joints", i, key))
    if "imu" in document and imu is None and document.get("kind") in ("quadruped", "humanoid"):
        found["imu"] = ("imu",)
    imu = imu if isinstance(imu, dict) else {}
    for key in ("frame", "position", "quat"):
        if imu.get(key, 0) is None:
            found[f"imu.{key}"] = ("imu", key)
    found |= {key: (key,) for key in ("feet", "fingertips") if document.get(key) == []}
    nulls = (key for key, value in transport.items() if value is None)
    return found | {f"transport.{key}": ("transport", key) for key in nulls}


def note_unknown(document: AnyMapping, here: Here) -> None:
    unknown = document.get("unknown") or []
    if not isinstance(unknown, list) or not all(isinstance(fact, str) for fact in unknown):
        return
    nulls = _nulls(document)
    for i, fact in enumerate(unknown):
        if fact != "joint_order" and fact not in nulls:
            why = f"is no fact; {alternatives(fact, [*nulls, 'joint_order'])}"
            if _given(document, fact):
                why = "is given now: take it from unknown"
            here.note(f"unknown names {fact!r}, which {why}", "unknown", i)
        if fact in unknown[:i]:
            here.note(f"unknown names {fact!r} twice; remove one", "unknown", i)
    for fact, place in nulls.items() if document.get("manufacturer") is not None else ():
        if fact not in unknown:
            here.note(
                f"{fact} is not given, and 'unknown' does not name it; add {fact!r} to unknown",
                *place,
            )


def _given(document: AnyMapping, fact: str) -> bool:
    part, _, key = fact.partition(".")
    values = joints_of(document) if part == "joints" else [document.get(part)]
    if not key:
        return part in ("imu", "feet", "fingertips") and bool(values[0])
    return any(isinstance(value, dict) and value.get(key) is not None for value in values)


_SOURCED = ("imu", "feet", "fingertips", "command_ranges", "mounts", "end_effectors", "capsules",
            "hand")  # fmt: skip


def note_sources(document: AnyMapping, here: Here) -> None:
    """Every group of figures that the file gives says where it was taken from."""
    for key in ("transport", "sources"):
        if key not in document:
            here.note(f"missing key {key!r}; add it, as of every robot with a manufacturer")
    sources = document.get("sources")
    if not isinstance(sources, dict):
        return
    joints = joints_of(document)
    of_joints = {"gains": ("stiffness", "damping"), "default": ("default",), "rest": ("rest",)}
    given = ["joints"]
    for group, keys in of_joints.items():
        given += [group] if any(j.get(key) is not None for j in joints for key in keys) else []
    for group in (*given, "transport", *filter(document.get, _SOURCED)):
        if group not in sources:
            here.note(
                f"sources does not say where {group!r} was taken from; add `{group}: …`", "sources"
            )
