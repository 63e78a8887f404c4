"""Mapping files: YAML into specs, every mistake named with file, line, alternatives and remedy.

See the package's docstring for the format, and `config/maps/` for ready files.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from unicon_core.errors import alternatives
from unicon_core.located_yaml import read_text
from unicon_core.packages import PACKAGE, package_file
from unicon_msgs_map.errors import MapError, MapFileError
from unicon_msgs_map.layout.check import check_publish, check_subscribe
from unicon_msgs_map.layout.messages import Messages, full_name
from unicon_msgs_map.layout.paths import PathError, Reference, parse_path, parse_reference
from unicon_msgs_map.layout.units import PER_SI
from unicon_msgs_map.mapfile.entry import Entry
from unicon_msgs_map.mapfile.include import Composed, compose
from unicon_msgs_map.spec import (
    FieldSpec,
    MessageMap,
    PublishSpec,
    Qos,
    SubscribeSpec,
    TrajectorySpec,
)

# https://design.ros2.org/articles/topic_and_service_names.html
_TOPIC = re.compile(r"(?:~?/)?[A-Za-z_][A-Za-z0-9_]*(?:/[A-Za-z_][A-Za-z0-9_]*)*")
WIDEST_TEXT = 64

_BOTH = ("topic", "type", "rate", "qos", "optional", "fields")
_SUBSCRIBE = (*_BOTH, "timeout", "on_timeout", "missing", "extra", "unnamed", "nonfinite")
_FIELD = ("state", "const", "scale", "sign", "offset", "unit", "quat", "by", "text", "checksum")
_QOS_WORDS: dict[str, tuple[str, ...]] = {
    "reliability": ("reliable", "best_effort"),
    "durability": ("volatile", "transient_local"),
    "history": ("keep_last", "keep_all"),
    "liveliness": ("automatic", "manual_by_topic"),
}
LONGEST_TIMEOUT = 60.0
"""Of a subscription in [s]: its states are commands and sensors, and a robot falls within 1."""
HIGHEST_RATE = 10_000.0
"""In [Hz]: as of a workflow's ticks."""
LONGEST_QOS = 86_400.0
"""Of deadline, lifespan and lease in [s]: a day."""
LARGEST = 1e12
"""|scale| and |offset|: nanoseconds in a second are 1e9. What is infinite makes NaN of a 0."""
_QOS_TIMES = ("deadline", "lifespan", "liveliness_lease")
QOS_PROFILES: dict[str, Qos] = {
    "default": Qos(),
    "sensor_data": Qos(reliability="best_effort", depth=5),
    "latest": Qos(reliability="best_effort", depth=1),
    "latched": Qos(durability="transient_local", depth=1),
}
_TOLERANCES = ("start_tolerance", "path_tolerance", "goal_tolerance", "goal_time")
_POLICIES: dict[str, tuple[str, ...]] = {
    "on_timeout": ("zero", "hold", "unset"),
    "missing": ("hold", "zero", "error"),
    "extra": ("ignore", "error"),
    "unnamed": ("error", "order"),
    "nonfinite": ("reject", "accept"),
}


def load_map(
    path: str | Path,
    typestore: str | Messages | Any | None = None,
    *,
    heard: Qos | None = None,
) -> MessageMap:
    """Read a mapping file.

    Args:
        path: the YAML file.
        typestore: distribution such as `humble`, a `Messages`, or a rosbags typestore; it
            outranks the file's own `typestore`. Default: the file's, else Jazzy.
        heard: of subscriptions that say no `qos`; None is `default`.

    Raises:
        MapFileError: the file cannot be read or says something wrong.
        MessageTypeError: a type or a field path is unknown.
    """
    path = Path(path)
    text = read_text(path, MapFileError)
    return parse_map(text, typestore, name=str(path), folder=path.parent, heard=heard)


def parse_map(
    text: str,
    typestore: str | Messages | Any | None = None,
    *,
    name: str = "mapping",
    folder: Path | None = None,
    heard: Qos | None = None,
) -> MessageMap:
    """Parse the text of a mapping.

    Args:
        text: the YAML.
        typestore: as for `load_map`.
        name: stands for the file in messages.
        folder: where relative paths under `messages` start; default is the working directory.
        heard: as for `load_map`.
    """
    found = compose(text, name, folder or Path())
    messages = _messages(found, typestore)
    publish = [_publish(e, messages) for e in found.publish]
    subscribe = [_subscribe(e, messages, heard or Qos()) for e in found.subscribe]
    trajectory = None if found.trajectory is None else _trajectory(found.trajectory)
    if not publish and not subscribe and trajectory is None:
        raise found.top.fail(
            "the message map maps nothing; add entries under 'publish' or 'subscribe'"
        )
    for direction, entries in (("publish", publish), ("subscribe", subscribe)):
        seen: dict[str, str | None] = {}
        for spec in entries:
            if spec.topic in seen:
                raise MapFileError(
                    f"{direction} has topic {spec.topic!r} twice (first {seen[spec.topic]}); "
                    "merge the two or rename one",
                    spec.where,
                )
            seen[spec.topic] = spec.where
    description = found.description.text("description") if found.description else ""
    return MessageMap(tuple(publish), tuple(subscribe), messages, name, description, trajectory)


def _messages(found: Composed, typestore: object) -> Messages:
    if isinstance(typestore, Messages):
        messages = typestore
    elif typestore is not None:
        messages = Messages(typestore)
    elif found.typestore is not None:
        try:
            messages = Messages(found.typestore.text("typestore"))
        except MapError as error:
            raise found.typestore.fail(error.message) from None
    else:
        messages = Messages()
    for entry, folder in found.messages:
        text = entry.text("an entry of 'messages'")
        try:
            inside = text.startswith(PACKAGE)
            path = package_file(text, "messages", MapFileError) if inside else folder / text
            messages.register_path(path)
        except MapError as error:
            raise entry.fail(error.message) from None
    return messages


def _publish(entry: Entry, messages: Messages) -> PublishSpec:
    keys = _keys(entry, "a publish entry", _BOTH)
    spec = PublishSpec(**_both(entry, keys, messages, receive=False))
    if spec.qos.history == "keep_all" and spec.qos.reliability == "reliable":
        # Fast DDS blocks a writer with a full history for 100 ms.
        raise keys["qos"].fail(
            f"topic {spec.topic!r} is reliable and keep_all, so a reader that hangs would stop the "
            "tick; say history: keep_last and a depth, or reliability: best_effort"
        )
    check_publish(spec)
    return spec


def _subscribe(entry: Entry, messages: Messages, unsaid: Qos) -> SubscribeSpec:
    keys = _keys(entry, "a subscribe entry", _SUBSCRIBE)
    values = _both(entry, keys, messages, receive=True)
    values |= {k: keys[k].one_of(k, c) for k, c in _POLICIES.items() if k in keys}
    if "qos" not in keys:
        values["qos"] = unsaid
    spec = SubscribeSpec(**values, timeout=_positive(keys, "timeout", LONGEST_TIMEOUT))
    check_subscribe(spec)
    return spec


def _trajectory(entry: Entry) -> TrajectorySpec:
    """Return what a map says of joint trajectories."""
    words = ("topic", "action")
    keys = entry.mapping("trajectory", (*words, "missing", *_TOLERANCES))
    values: dict[str, Any] = {w: _name(keys[w], w) for w in words if w in keys}
    if not values:
        raise entry.fail("trajectory has neither topic nor action; give one of them, or both")
    if "missing" in keys:
        values["missing"] = keys["missing"].one_of("missing", ("error", "hold"))
    for key in _TOLERANCES:
        if key in keys:
            values[key] = keys[key].number(key, highest=LONGEST_TIMEOUT)
            if values[key] < 0.0:
                raise keys[key].fail(f"{key} must be 0 or more, not {values[key]:g}")
    return TrajectorySpec(**values, where=f"{entry.where}: trajectory")


def _keys(entry: Entry, what: str, known: tuple[str, ...]) -> dict[str, Entry]:
    keys = entry.mapping(what, known)
    for key in ("topic", "type", "fields"):
        if key not in keys:
            raise entry.fail(f"{what} lacks {key!r}; it needs topic, type and fields")
    return keys


def _both(
    entry: Entry, keys: dict[str, Entry], messages: Messages, *, receive: bool
) -> dict[str, Any]:
    """Return the attributes that both directions have, by name."""
    topic = _name(keys["topic"], "topic")
    try:
        kind = full_name(keys["type"].text("type"))
        messages.struct(kind)
    except MapFileError:
        raise
    except MapError as error:
        raise type(error)(error.message, f"{keys['type'].where}: {topic}") from None
    return {
        "topic": topic,
        "type": kind,
        "qos": _qos(keys.get("qos")),
        "fields": _fields(keys["fields"], topic, receive=receive),
        "messages": messages,
        "rate": _positive(keys, "rate", HIGHEST_RATE),
        "optional": keys["optional"].boolean("optional") if "optional" in keys else False,
        "where": f"{entry.where}: {topic}",
    }


def _name(entry: Entry, what: str) -> str:
    """Return a value as the name of a topic or action."""
    name = entry.text(what)
    if len(name) > 255 or "__" in name or not _TOPIC.fullmatch(name):
        shown = name if len(name) <= 60 else f"{name[:57]}…"
        raise entry.fail(
            f"{what} {shown!r} is not a ROS name; write words of letters, digits and '_' between "
            "slashes, like imu/data"
        )
    return name


def _positive(keys: dict[str, Entry], key: str, highest: float) -> float | None:
    if key not in keys or keys[key].value is None:
        return None
    return keys[key].number(key, positive=True, highest=highest)


def _qos(entry: Entry | None) -> Qos:
    if entry is None:
        return Qos()
    if isinstance(entry.value, str):
        if entry.value not in QOS_PROFILES:
            raise entry.fail(
                f"qos profile {entry.value!r} is unknown; "
                f"{alternatives(entry.value, QOS_PROFILES)}; or write a mapping"
            )
        return QOS_PROFILES[entry.value]
    keys = entry.mapping("qos", (*_QOS_WORDS, "depth", *_QOS_TIMES))
    values: dict[str, Any] = {
        key: keys[key].one_of(f"qos {key}", words)
        for key, words in _QOS_WORDS.items()
        if key in keys
    }
    values |= {
        key: keys[key].number(f"qos {key}", positive=True, highest=LONGEST_QOS)
        for key in _QOS_TIMES
        if key in keys
    }
    if "depth" in keys:
        depth = keys["depth"].number("qos depth", positive=True)
        if not depth.is_integer():
            raise keys["depth"].fail(f"qos depth must be a whole number, not {depth}")
        values["depth"] = int(depth)
    return Qos(**values)


def _fields(entry: Entry, topic: str, *, receive: bool) -> tuple[FieldSpec, ...]:
    fields = entry.mapping("fields")
    if not fields and receive:
        raise entry.fail("fields maps nothing; write field: state")
    return tuple(_field(path, value, topic, receive=receive) for path, value in fields.items())


def _field(path: str, entry: Entry, topic: str, *, receive: bool) -> FieldSpec:
    where = f"{entry.where}: {topic}"
    try:
        steps = parse_path(path)
        if not isinstance(entry.value, dict):
            return FieldSpec(path, steps, parse_reference(entry.value), where=where)
        keys = entry.mapping(f"field {path!r}", _FIELD)
        plain = FieldSpec(path, steps, Reference("const", value=0), where=where)
        if "checksum" in keys:
            return _checksum(keys, plain)
        if ("state" in keys) == ("const" in keys):
            raise plain.file_error("give either 'state' or 'const'")
        if "const" in keys:
            return replace(plain, source=Reference("const", value=keys["const"].value))
        source = parse_reference(keys["state"].text("state"))
    except PathError as error:
        raise MapFileError(str(error), where) from None
    unit = keys["unit"].text("unit") if "unit" in keys else None
    if unit is not None and unit not in PER_SI:
        listed = alternatives(unit, PER_SI, limit=12)
        raise keys["unit"].fail(f"{path}: unit {unit!r} is unknown; {listed}")
    quats = ("wxyz_from_xyzw" if receive else "xyzw_from_wxyz", "none")
    return FieldSpec(
        path,
        steps,
        source,
        scale=_scale(path, keys),
        offset=_numbers(keys["offset"], f"{path}: offset") if "offset" in keys else 0.0,
        unit=unit,
        quat=keys["quat"].one_of(f"{path}: quat", quats) if "quat" in keys else None,
        by=keys["by"].text("by") if "by" in keys else None,
        text=_text(path, keys["text"]) if "text" in keys else None,
        where=where,
    )


def _checksum(keys: dict[str, Entry], field: FieldSpec) -> FieldSpec:
    other = next((key for key in keys if key != "checksum"), None)
    if other is not None:
        raise keys[other].fail(f"{field.path}: a checksum is computed; drop {other!r}")
    kind = keys["checksum"].one_of(f"{field.path}: checksum", ("unitree",))
    return replace(field, checksum=kind)


def _text(path: str, entry: Entry) -> str:
    form = entry.text("text")
    if any(len(n) > 2 or int(n) > WIDEST_TEXT for n in re.findall(r"[0-9]+", form)):
        raise entry.fail(f"{path}: text {form[:40]!r} is wider than {WIDEST_TEXT}; write 8.2f")
    try:
        width = len(format(0.0, form))
    except ValueError:
        raise entry.fail(
            f"{path}: text {form!r} is not a format; write a width, as in 8.2f"
        ) from None
    if width != len(format(-1.5, form)) or width < 2:
        raise entry.fail(f"{path}: text {form!r} has no fixed width; write one, as in 8.2f")
    return form


def _scale(path: str, keys: dict[str, Entry]) -> float | tuple[float, ...]:
    scale = _numbers(keys["scale"], f"{path}: scale") if "scale" in keys else 1.0
    sign = _numbers(keys["sign"], f"{path}: sign") if "sign" in keys else 1.0
    if np.any(np.abs(sign) != 1.0):
        raise keys["sign"].fail(f"{path}: sign must be 1 or -1; use scale for other factors")
    if np.any(np.equal(scale, 0.0)):
        raise keys["scale"].fail(f"{path}: scale must not be 0; drop the field instead")
    if isinstance(scale, tuple) and isinstance(sign, tuple) and len(scale) != len(sign):
        raise keys["sign"].fail(
            f"{path}: sign has {len(sign)} entries, scale has {len(scale)}; give equally many"
        )
    product: float | list[float] = np.multiply(scale, sign).tolist()
    return tuple(product) if isinstance(product, list) else product


def _numbers(entry: Entry, what: str) -> float | tuple[float, ...]:
    if isinstance(entry.value, list):
        return tuple(item.number(what, highest=LARGEST) for item in entry.items(what))
    return entry.number(what, highest=LARGEST)
