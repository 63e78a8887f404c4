"""Maps that compose: a map begins with the entries of those that it includes, for `parse_map`.

    include: default
    publish:
      - {topic: odom, rate: 20}               # the keys that are given change the included entry
      - {topic: /clock, remove: true}

Everything is merged before anything is judged, so what an entry lacks may stand in an included map.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

from unicon_core.errors import alternatives
from unicon_core.located_yaml import parse_yaml, read_text
from unicon_core.resources import find_config
from unicon_msgs_map.errors import MapFileError
from unicon_msgs_map.mapfile.entry import Entry

DIRECTIONS = ("publish", "subscribe")
_TRAJECTORY = "trajectory"
_TOP = ("description", "include", "typestore", "messages", *DIRECTIONS, _TRAJECTORY)
_REMOVE = "remove"
MOST_MAPS = 32
"""Maps that one map includes, each counted as often as it is: maps may come from anybody."""


@dataclass(frozen=True)
class Composed:
    """A map together with what it includes.

    Attributes:
        top: the map itself.
        description: its own words, or None.
        typestore: the one that counts, or None: its own, else the included maps'.
        messages: entries of `messages`, each with the folder that its path begins in.
        publish: entries, each a mapping; those of included maps first.
        subscribe: the same.
        trajectory: the mapping of that key, or None.
    """

    top: Entry
    description: Entry | None = None
    typestore: Entry | None = None
    messages: list[tuple[Entry, Path]] = field(default_factory=list)
    publish: list[Entry] = field(default_factory=list)
    subscribe: list[Entry] = field(default_factory=list)
    trajectory: Entry | None = None

    def entries(self, direction: str) -> list[Entry]:
        """Return the entries of `publish` or `subscribe`."""
        return self.publish if direction == "publish" else self.subscribe


@dataclass(frozen=True)
class _Merged(Entry):
    """A mapping whose values come from several files; its place is that of the last."""

    parts: dict[str, Entry] = field(default_factory=dict)

    def mapping(self, what: str, known: tuple[str, ...] = ()) -> dict[str, Entry]:
        for key, entry in self.parts.items():
            if known and key not in known:
                raise entry.fail(f"{what} has no key {key!r}; {alternatives(key, known)}")
        return dict(self.parts)


def compose(text: str, name: str, folder: Path) -> Composed:
    """Read a map and all that it includes.

    Args:
        text: the YAML.
        name: stands for the file in messages.
        folder: where relative paths begin.

    Raises:
        MapFileError: a map is not one, cannot be found, or includes itself.
    """
    own = Path(name).absolute().resolve()
    return _composed(text, name, folder, (own,), iter(range(MOST_MAPS)))


def _composed(
    text: str, name: str, folder: Path, above: tuple[Path, ...], left: Iterator[int]
) -> Composed:
    document = parse_yaml(text, name, MapFileError)
    top = Entry({} if document.value is None else document.value, document)
    keys = top.mapping("a message map", _TOP)
    found = Composed(top, keys.get("description"))
    included = [_included(e, folder, above, left) for e in _included_names(keys)]
    typestore, trajectory = keys.get("typestore"), None
    for other in included:
        trajectory = _over(trajectory, other.trajectory)
        typestore = _one_typestore(typestore, other.typestore, "typestore" in keys, top)
        found.messages.extend(other.messages)
        for direction in DIRECTIONS:
            for entry in other.entries(direction):
                _put(found.entries(direction), entry)
    found.messages.extend((entry, folder) for entry in _listed(keys, "messages"))
    for direction in DIRECTIONS:
        inherited = [_topic(entry) for entry in found.entries(direction)]
        for entry in _listed(keys, direction):
            if _topic(entry) in inherited:  # once: a second one is the map's own mistake
                inherited.remove(_topic(entry))
                _put(found.entries(direction), entry)
            else:
                _add(found.entries(direction), entry, direction, "include" in keys)
    trajectory = _over(trajectory, keys.get(_TRAJECTORY))
    return replace(found, typestore=typestore, trajectory=trajectory)


def _included_names(keys: dict[str, Entry]) -> list[Entry]:
    if "include" not in keys:
        return []
    said = keys["include"]
    return [said] if isinstance(said.value, str) else said.items("include")


def _included(entry: Entry, folder: Path, above: tuple[Path, ...], left: Iterator[int]) -> Composed:
    name = entry.text("an entry of 'include'")
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


def _one_typestore(
    chosen: Entry | None, other: Entry | None, own: bool, top: Entry
) -> Entry | None:
    if own or other is None or chosen is None or chosen.value == other.value:
        return chosen if chosen is not None else other
    raise top.fail(
        f"included maps have the typestores {chosen.value!r} and {other.value!r}; "
        "say typestore: NAME in this map"
    )


def _listed(keys: dict[str, Entry], key: str) -> list[Entry]:
    return keys[key].items(key) if key in keys and keys[key].value is not None else []


def _topic(entry: Entry) -> object:
    keys = entry.parts if isinstance(entry, _Merged) else entry.value
    value = keys.get("topic") if isinstance(keys, dict) else None
    return value.value if isinstance(value, Entry) else value


def _add(entries: list[Entry], entry: Entry, direction: str, includes: bool) -> None:
    """Add an entry of a topic that no included map has."""
    if isinstance(entry.value, dict) and _REMOVE in entry.value:
        known = [str(_topic(each)) for each in entries]
        topic = str(_topic(entry))
        raise entry.fail(
            f"{direction} has no topic {topic!r} of an included map to remove; "
            + (alternatives(topic, known) if includes and known else "include: NAME brings some")
        )
    entries.append(entry)


def _put(entries: list[Entry], entry: Entry) -> None:
    """Let an entry change the one of its topic, or add it where there is none."""
    place = next((i for i, e in enumerate(entries) if _topic(e) == _topic(entry)), None)
    if place is None or not isinstance(_topic(entry), str):
        entries.append(entry)
        return
    keys = entry.mapping("a map's entry")
    if _REMOVE in keys:
        if not keys[_REMOVE].boolean(_REMOVE) or len(keys) > 2:
            raise keys[_REMOVE].fail("remove must be true, and stand beside the topic alone")
        del entries[place]
        return
    before = entries[place].mapping("a map's entry")
    if "type" in keys and _short(keys["type"]) != _short(before.get("type", keys["type"])):
        entries[place] = entry  # another message: nothing of the old one fits it
        return
    if "fields" in keys and "fields" in before:
        keys["fields"] = _merged(before["fields"], keys["fields"], "field")
    entries[place] = _Merged(None, entry.document, entry.at, before | keys)


def _over(old: Entry | None, new: Entry | None) -> Entry | None:
    """Let a mapping change another one, key by key; an empty one removes it."""
    if old is None or new is None:
        return old if new is None else new
    if new.value is None and not isinstance(new, _Merged):
        return None
    return _merged(old, new, _TRAJECTORY)


def _short(kind: Entry) -> str:
    return str(kind.value).replace("/msg/", "/")


def _merged(old: Entry, new: Entry, what: str) -> Entry:
    """Return a mapping in which keys of the new one count, and its empty values remove."""
    parts = old.mapping(what) | new.mapping(what)
    gone = {key for key, entry in new.mapping(what).items() if entry.value is None}
    for key in gone:
        if key not in old.mapping(what):
            known = alternatives(key, list(old.mapping(what)))
            raise new.mapping(what)[key].fail(f"there is no {what} {key!r} to remove; {known}")
    kept = {key: entry for key, entry in parts.items() if key not in gone}
    return _Merged(None, new.document, new.at, kept)
