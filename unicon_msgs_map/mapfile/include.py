"""Maps that compose: a map begins with the entries of those that it includes, for `parse_map`.

    include: default
    publish:
      - {topic: odom, rate: 20}               # the keys that are given change the included entry
      - {topic: /clock, remove: true}

Everything is merged before anything is judged, so what an entry lacks may stand in an included map.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from unicon_base import UniconError, alternatives
from unicon_base.located_yaml import Located, Where, parse_yaml, read_text
from unicon_base.packages import PACKAGE
from unicon_base.resources import find_config
from unicon_msgs_map.errors import MapFileError
from unicon_msgs_map.mapfile.document import DIRECTIONS

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
