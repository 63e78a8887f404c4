"""YAML with line numbers, for error messages that point at the culprit."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from pathlib import Path

from unicon_core.bounded_yaml import MAX_SIZE, Node, YamlError, compose
from unicon_msgs_map.errors import MapFileError, alternatives

__all__ = ["Entry", "read_yaml"]


@dataclass
class Entry:
    """A YAML value and where it stands.

    Attributes:
        value: scalar, list of `Entry` or dict of str to `Entry`.
        where: `file:line` or `file:line: topic`.
    """

    value: object
    where: str

    def fail(self, message: str) -> MapFileError:
        """Return the error to raise about this value."""
        return MapFileError(message, self.where)

    def mapping(self, what: str, known: tuple[str, ...] = ()) -> dict[str, Entry]:
        """Return the value as a mapping whose keys are all known (any, where none is listed)."""
        if not isinstance(self.value, dict):
            raise self.fail(f"{what} must be a mapping of names to values, not {self.plain()!r}")
        for key, entry in self.value.items():
            if known and key not in known:
                raise entry.fail(f"{what} has no key {key!r}; {alternatives(key, known)}")
        return self.value

    def items(self, what: str) -> list[Entry]:
        """Return the value as a list."""
        if not isinstance(self.value, list):
            raise self.fail(f"{what} must be a list ('- …' lines), not {self.plain()!r}")
        return self.value

    def text(self, what: str) -> str:
        """Return the value as a non-empty string."""
        if not isinstance(self.value, str) or not self.value:
            raise self.fail(f"{what} must be text, not {self.plain()!r}")
        return self.value

    def one_of(self, what: str, choices: tuple[str, ...]) -> str:
        """Return the value as one of some words."""
        if self.value not in choices:
            raise self.fail(f"{what} is {self.plain()!r}; choose one of {', '.join(choices)}")
        return str(self.value)

    def number(self, what: str, *, positive: bool = False, highest: float = 1e30) -> float:
        """Return the value as a number of a size up to `highest`; infinities never are."""
        value = self.value
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not isfinite(value):
            raise self.fail(f"{what} must be a number, not {self.plain()!r}")
        if positive and not value > 0:
            raise self.fail(f"{what} must be above 0, not {value}")
        if not abs(value) <= highest:
            raise self.fail(f"{what} must be at most {highest:g}, not {value!r:.20}")
        return float(value)

    def boolean(self, what: str) -> bool:
        """Return the value as true or false."""
        if not isinstance(self.value, bool):
            raise self.fail(f"{what} must be true or false, not {self.plain()!r}")
        return self.value

    def plain(self) -> object:
        """Return the value without places."""
        if isinstance(self.value, dict):
            return {key: entry.plain() for key, entry in self.value.items()}
        if isinstance(self.value, list):
            return [entry.plain() for entry in self.value]
        return self.value


def read_yaml(text: str, name: str) -> Entry:
    """Parse YAML text.

    Args:
        text: the YAML.
        name: file name for messages.

    Raises:
        MapFileError: it does not parse, is beyond the bounds, or a key stands twice.
    """
    try:
        root = compose(text)
        return Entry({}, f"{name}:1") if root is None else _convert(root, name)
    except YamlError as error:
        raise MapFileError(f"not valid YAML: {error.problem}", f"{name}:{error.line}") from None


def read_text(path: Path) -> str:
    """Return a file's text.

    Raises:
        MapFileError: it cannot be read, or is too large.
    """
    try:
        with path.open("rb") as file:
            data = file.read(4 * MAX_SIZE + 1)
        return data.decode("utf-8")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise MapFileError(f"cannot read the mapping: {reason}", str(path)) from None


def _convert(node: Node, name: str) -> Entry:
    where = f"{name}:{node.line}"
    if node.tag:
        raise YamlError(
            node.line, f"tag {node.tag!r} is not read; write plain values, lists and mappings"
        )
    if node.kind == "list":
        return Entry([_convert(item, name) for item in node.value], where)
    if node.kind != "mapping":
        return Entry(node.value, where)
    found: dict[str, Entry] = {}
    for key_node, value_node in node.value:
        key = key_node.value
        line = f"{name}:{key_node.line}"
        if key_node.kind != "scalar" or key_node.tag or isinstance(key, (float, type(None))):
            raise MapFileError("a key must be one word or path", line)
        key = str(key)
        if key in found:
            raise MapFileError(f"key {key!r} stands twice; drop one", line)
        found[key] = _convert(value_node, name)
    return Entry(found, where)
