"""YAML with line numbers, for error messages that point at the culprit."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from unicon_msgs_map.errors import MapDependencyError, MapFileError, alternatives

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
        if isinstance(value, bool) or not isinstance(value, (int, float)) or value != value:
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
        MapFileError: it does not parse, or a key stands twice.
    """
    try:
        import yaml
    except ImportError as error:  # pragma: no cover - a hard dependency of the package
        raise MapDependencyError(
            f"the message map needs PyYAML ({error}): pip install pyyaml"
        ) from None
    loader = yaml.SafeLoader(text)
    try:
        node = loader.get_single_node()
        if node is None:
            return Entry({}, f"{name}:1")
        return _convert(loader, node, name)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = mark.line + 1 if mark else 1
        raise MapFileError(f"not valid YAML: {error.problem}", f"{name}:{line}") from None
    except yaml.YAMLError as error:
        raise MapFileError(f"not valid YAML: {str(error).splitlines()[0]}", f"{name}:1") from None
    finally:
        loader.dispose()


def read_text(path: Path) -> str:
    """Return a file's text.

    Raises:
        MapFileError: it cannot be read.
    """
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise MapFileError(f"cannot read the mapping: {reason}", str(path)) from None


def _convert(loader: object, node: object, name: str) -> Entry:
    import yaml

    assert isinstance(node, yaml.Node)
    where = f"{name}:{node.start_mark.line + 1}"
    if isinstance(node, yaml.MappingNode):
        found: dict[str, Entry] = {}
        for key_node, value_node in node.value:
            key = key_node.value if isinstance(key_node, yaml.ScalarNode) else None
            line = f"{name}:{key_node.start_mark.line + 1}"
            if key is None:
                raise MapFileError("a key must be one word or path", line)
            if key in found:
                raise MapFileError(f"key {key!r} stands twice; drop one", line)
            entry = _convert(loader, value_node, name)
            found[key] = entry
        return Entry(found, where)
    if isinstance(node, yaml.SequenceNode):
        return Entry([_convert(loader, item, name) for item in node.value], where)
    assert isinstance(loader, yaml.SafeLoader)
    return Entry(loader.construct_object(node, deep=True), where)
