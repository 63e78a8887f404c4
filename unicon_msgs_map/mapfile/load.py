"""Mapping files: YAML into specs, every mistake named with file, line, alternatives and remedy.

See the package's docstring for the format, and `config/maps/` for ready files. What a file says is
read first, then compared with the message types; of each all mistakes are raised at once.
"""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from unicon_base import AnyDict, UniconError
from unicon_base.located_yaml import Where, read_text
from unicon_base.packages import PACKAGE, package_file
from unicon_base.schema.read import read
from unicon_msgs_map.errors import MapError, MapFileError
from unicon_msgs_map.layout.messages import DEFAULT_DISTRO, Messages, full_name
from unicon_msgs_map.layout.paths import PathError, Reference, parse_path, parse_reference
from unicon_msgs_map.layout.template import check_published, check_received
from unicon_msgs_map.mapfile.document import (
    QOS_PROFILES,
    Conversion,
    Entry,
    MapDocument,
    SubscribeEntry,
    missing_keys,
)
from unicon_msgs_map.mapfile.include import Composed, compose
from unicon_msgs_map.spec import FieldSpec, MessageMap, PublishSpec, Qos, Reception, SubscribeSpec


def load_map(
    path: str | Path, typestore: str | Messages | Any | None = None, *, heard: Qos | None = None
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
    said = read(MapDocument, found, "message map", lambda mistakes: missing_keys(found, mistakes))
    messages = _messages(said, found, typestore)
    problems: list[UniconError] = []
    publish = [
        PublishSpec(**_both(entry, ("publish", i), found, messages, Qos(), problems))
        for i, entry in enumerate(said.publish or ())
    ]
    subscribe = [
        SubscribeSpec(
            **_both(entry, ("subscribe", i), found, messages, heard or Qos(), problems),
            **{each.name: getattr(entry, each.name) for each in fields(Reception)},
        )
        for i, entry in enumerate(said.subscribe or ())
    ]
    if problems:
        raise type(problems[0]).of(f"message map {name}", problems)
    trajectory = said.trajectory
    if not publish and not subscribe and trajectory is None:
        raise found.error(
            (), "the message map maps nothing; add entries under 'publish' or 'subscribe'"
        )
    if trajectory is not None:
        place = f"{found.where(('trajectory',))}: trajectory"
        trajectory = replace(trajectory, where=place)
    description = said.description or ""
    return MessageMap(tuple(publish), tuple(subscribe), messages, name, description, trajectory)


def _messages(said: MapDocument, found: Composed, typestore: object) -> Messages:
    where: Where = ("typestore",)
    try:
        given = typestore or said.typestore or DEFAULT_DISTRO
        messages = given if isinstance(given, Messages) else Messages(given)
        for i, path in enumerate(said.messages or ()):
            where = ("messages", i)
            inside = path.startswith(PACKAGE)
            messages.register_path(package_file(path, "messages", MapFileError) if inside else path)
    except MapError as error:
        raise found.error(where, error.message) from None
    return messages


def _both(
    entry: Entry,
    where: Where,
    found: Composed,
    messages: Messages,
    unsaid: Qos,
    problems: list[UniconError],
) -> AnyDict:
    """Return the attributes that both directions have, by name.

    Args:
        entry: what the map says.
        where: it says so.
        found: the map.
        messages: the types.
        unsaid: the quality of service where the entry has none.
        problems: gets what does not fit the types.
    """

    def place(*below: str) -> str:
        return f"{found.where((*where, *below))}: {entry.topic}"

    qos = QOS_PROFILES[entry.qos] if isinstance(entry.qos, str) else entry.qos or unsaid
    specs: list[FieldSpec] = []
    values = {
        "topic": entry.topic,
        "type": entry.type,
        "fields": (),
        "messages": messages,
        "rate": entry.rate,
        "qos": qos,
        "optional": entry.optional,
        "where": place(),
    }
    try:
        kind = full_name(entry.type or "")
        message = messages.struct(kind)
    except MapError as error:
        located = type(error)(error.message, place("type"))
        problems.append(error if isinstance(error, MapFileError) else located)
        return values
    before = len(problems)
    mapped = entry.fields or {}
    names = [p for p, said in mapped.items() if str(getattr(said, "state", said)).startswith("$")]
    for path, said in mapped.items():
        try:
            field = _field(path, said, place("fields", path))
            if isinstance(entry, SubscribeEntry):
                check_received(field, message, names)
            else:
                check_published(field, message)
            specs.append(field)
        except MapError as error:
            problems.append(error)
    writes = any(field.source.kind == "state" for field in specs)
    if isinstance(entry, SubscribeEntry) and not writes and len(problems) == before:
        problems.append(MapFileError("the entry writes no state; map a field to one", place()))
    return values | {"type": kind, "fields": tuple(specs)}


def _field(path: str, said: Any, place: str) -> FieldSpec:
    """Return a field of what a map says of it at a place.

    Raises:
        MapFileError: a path does not parse.
    """
    try:
        steps = parse_path(path)
        if not isinstance(said, Conversion):
            return FieldSpec(path, steps, parse_reference(said), where=place)
        if said.state is None:
            const = 0 if said.checksum else said.const
            source = Reference("const", value=const)
            return FieldSpec(path, steps, source, checksum=said.checksum, where=place)
        source = parse_reference(said.state)
    except PathError as error:
        raise MapFileError(str(error), place) from None
    return FieldSpec(
        path,
        steps,
        source,
        scale=said.factor,
        offset=tuple(said.offset) if isinstance(said.offset, list) else said.offset,
        unit=said.unit,
        quat=said.quat,
        by=said.by,
        text=said.text,
        where=place,
    )
