"""Mapping files: YAML into specs, every mistake named with file, line, alternatives and remedy.

See the package's docstring for the format, and `config/maps/` for ready files. What a file says is
read first, then compared with the message types; of each all mistakes are raised at once. A map
begins with the entries of those that it includes:

    include: default
    publish:
      - {topic: odom, rate: 20}               # the keys that are given change the included entry
      - {topic: /clock, remove: true}

Everything is merged before anything is judged, so what an entry lacks may stand in an included map.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from unicon_base import AnyDict, UniconError, alternatives
from unicon_base.located_yaml import Located, Where, parse_yaml, read_text
from unicon_base.packages import PACKAGE, package_file
from unicon_base.resources import find_config
from unicon_base.schema.read import read
from unicon_msgs_map.errors import MapError, MapFileError
from unicon_msgs_map.layout.messages import DEFAULT_DISTRO, Messages, full_name
from unicon_msgs_map.layout.paths import PathError, Reference, parse_path, parse_reference
from unicon_msgs_map.layout.template import check_published, check_received
from unicon_msgs_map.mapfile.document import (
    DIRECTIONS,
    QOS_PROFILES,
    Conversion,
    Entry,
    MapDocument,
    SubscribeEntry,
    missing_keys,
)
from unicon_msgs_map.spec import FieldSpec, MessageMap, PublishSpec, Qos, Reception, SubscribeSpec

_OWN = ("schema", "description", "include")
_REMOVE = "remove"
MOST_MAPS = 32
"""Maps that one map includes, each counted as often as it is: maps may come from anybody."""


@dataclass(frozen=True)
class _Node:
    """A value, the file that says it and where; parts of a merged one are nodes themselves."""

    value: Any
    document: Located
    at: Where = ()

    def fail(self, message: str) -> UniconError:
        return self.document.error(self.at, message)

    def parts(self) -> dict[Any, _Node]:
        """Return what a mapping or list holds, by key or number; {} of anything else."""
        value = self.value
        pairs = enumerate(value) if isinstance(value, list) else ()
        return {
            key: each if isinstance(each, _Node) else _Node(each, self.document, (*self.at, key))
            for key, each in (value.items() if isinstance(value, dict) else pairs)
        }

    def said(self, key: str) -> Any:
        """Return what stands below a key, None where nothing does."""
        part = self.parts().get(key)
        return None if part is None else part.value


class Composed(Located):
    """A map together with what it includes, as one document whose lines are of several files.

    Args:
        top: the merged map.
    """

    def __init__(self, top: _Node) -> None:
        self._origins: dict[Where, _Node] = {}
        super().__init__(top.document.path, self._plain(top, ()), {}, MapFileError)

    def _plain(self, node: _Node, where: Where) -> Any:
        self._origins[where] = node
        if isinstance(node.value, dict | list):
            parts = {k: self._plain(n, (*where, k)) for k, n in node.parts().items()}
            return parts if isinstance(node.value, dict) else list(parts.values())
        return node.value

    def where(self, where: Where) -> str:
        while where not in self._origins:
            where = where[:-1]
        node = self._origins[where]
        return node.document.where(node.at)


def compose(text: str, name: str, folder: Path) -> Composed:
    """Read a map and all that it includes.

    Args:
        text: the YAML.
        name: stands for the file in messages.
        folder: where relative paths begin; those of `messages` begin in their map's.

    Raises:
        MapFileError: a map is not one, cannot be found, includes itself, or changes what the
            included ones lack.
    """
    own = Path(name).absolute().resolve()
    return Composed(_composed(text, name, folder, (own,), iter(range(MOST_MAPS))))


def _composed(
    text: str, name: str, folder: Path, above: tuple[Path, ...], left: Iterator[int]
) -> _Node:
    document = parse_yaml(text, name, MapFileError)
    top = _Node({} if document.value is None else document.value, document)
    if not isinstance(top.value, dict):
        raise top.fail("a message map is a mapping; begin with publish: or subscribe:")
    keys, found = top.parts(), dict[Any, _Node]()
    for entry in _included_names(keys):
        other = _included(entry, folder, above, left).parts()
        both = [each["typestore"].value for each in (found, other) if "typestore" in each]
        if "typestore" not in keys and len(both) > 1 and both[0] != both[1]:
            raise top.fail(
                f"included maps have the typestores {both[0]!r} and {both[1]!r}; "
                "say typestore: NAME in this map"
            )
        for key, node in other.items():
            if key not in _OWN:
                found[key] = _added(key, found.get(key), node, own=False)
    for key, node in keys.items():
        if key == "messages" and isinstance(node.value, list):
            node = _Node([_from(folder, each) for each in node.parts().values()], document, node.at)
        found[key] = _added(key, found.get(key), node, own=True)
    return _Node(found, document)


def _included_names(keys: dict[Any, _Node]) -> list[_Node]:
    said = keys.get("include")
    if said is None or isinstance(said.value, dict):
        return []
    names = [said] if isinstance(said.value, str) else said.parts().values()
    return [each for each in names if isinstance(each.value, str)]  # others are refused later


def _included(entry: _Node, folder: Path, above: tuple[Path, ...], left: Iterator[int]) -> _Node:
    name = entry.value
    if next(left, None) is None:
        raise entry.fail(f"more than {MOST_MAPS} maps are included; name fewer")
    try:
        path = find_config("maps", name, error=MapFileError, relative_to=folder)
    except MapFileError as error:
        raise entry.fail(f"include: {error.message}") from None
    if path in above:
        raise entry.fail(f"include {name!r} leads back to {path}; a map cannot include itself")
    text = read_text(path, MapFileError)
    return _composed(text, str(path), path.parent, (*above, path), left)


def _from(folder: Path, path: _Node) -> _Node:
    """Return a path of `messages` from the map's folder on."""
    said = path.value
    if not isinstance(said, str) or said.startswith(PACKAGE):
        return path
    return _Node(str(folder / said), path.document, path.at)


def _added(key: str, old: _Node | None, new: _Node, *, own: bool) -> _Node:
    """Return what a key of a map makes of what stood there; `own` is not of an included map."""
    if key == "trajectory" and old is not None and new.value is not None:
        return _merged(old, new, key)
    if key not in (*DIRECTIONS, "messages") or not isinstance(new.value, (list, type(None))):
        return new
    entries = [] if old is None else list(old.parts().values())
    inherited = [entry.said("topic") for entry in entries]
    for entry in new.parts().values():
        topic = entry.said("topic")
        if key == "messages":
            entries.append(entry)
        elif not own or topic in inherited:
            if own:  # once: a second one is the map's own mistake
                inherited.remove(topic)
            _put(entries, entry)
        elif entry.said(_REMOVE) is not None:
            known = [str(each.said("topic")) for each in entries]
            remedy = alternatives(str(topic), known) if old else "include: NAME brings some"
            text = f"{key} has no topic {str(topic)!r} of an included map to remove; {remedy}"
            raise entry.fail(text)
        else:
            entries.append(entry)
    return _Node(entries, new.document, new.at)


def _put(entries: list[_Node], entry: _Node) -> None:
    """Let an entry change the one of its topic, or add it where there is none."""
    topic = entry.said("topic")
    place = next((i for i, e in enumerate(entries) if e.said("topic") == topic), None)
    if place is None or not isinstance(topic, str):
        entries.append(entry)
        return
    keys, before = entry.parts(), entries[place].parts()
    if _REMOVE in keys:
        if keys[_REMOVE].value is not True or len(keys) > 2:
            raise keys[_REMOVE].fail("remove must be true, and stand beside the topic alone")
        del entries[place]
        return
    kinds = [str(each["type"].value) for each in (before, keys) if "type" in each]
    if len({kind.replace("/msg/", "/") for kind in kinds}) > 1:
        entries[place] = entry  # another message: nothing of the old one fits it
        return
    if "fields" in keys and "fields" in before:
        keys["fields"] = _merged(before["fields"], keys["fields"], "field")
    entries[place] = _Node(before | keys, entry.document, entry.at)


def _merged(old: _Node, new: _Node, what: str) -> _Node:
    """Return a mapping in which keys of the new one count, and its empty values remove."""
    if not isinstance(new.value, dict):
        return new
    before, keys = old.parts(), new.parts()
    for key, node in keys.items():
        if node.value is None and before.pop(key, None) is None:
            known = alternatives(str(key), map(str, before))
            raise node.fail(f"there is no {what} {key!r} to remove; {known}")
    kept = before | {key: node for key, node in keys.items() if node.value is not None}
    return _Node(kept, new.document, new.at)


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
    values = {key: getattr(entry, key) for key in ("topic", "type", "rate", "optional")}
    values |= {"fields": (), "messages": messages, "qos": qos, "where": place()}
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
