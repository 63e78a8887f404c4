"""YAML with the line of every value, so that an error can name `file:line`, for every loader."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from unicon_core.bounded_yaml import MAX_SIZE, Node, YamlError, compose
from unicon_core.errors import UniconError

__all__ = ["Located", "parse_value", "read_text", "read_yaml"]

Where = tuple[str | int, ...]


def parse_value(text: str) -> Any:
    """Return the value of a short text, such as what follows `=` in `--set`.

    Raises:
        YamlError: it is not YAML, or beyond the bounds of `bounded_yaml`.
    """
    root = compose(text)
    return None if root is None else _value(root, (), {})


class Located:
    """A document and the line of each of its values.

    Args:
        path: the file, as it is to be named in messages.
        value: the document.
        lines: line (from 1) of each value; keys are paths such as `("joints", 3, "lower")`.
        error_type: the class of its errors.
    """

    def __init__(
        self,
        path: Path,
        value: Any,
        lines: dict[Where, int],
        error_type: type[UniconError] = UniconError,
    ) -> None:
        self.path = path
        self.value = value
        self._lines = lines
        self._error_type = error_type

    def where(self, where: Where) -> str:
        """Return `file:line` of a value; its parent's line if it is absent."""
        while where and where not in self._lines:
            where = where[:-1]
        return f"{self.path}:{self._lines.get(where, 1)}"

    def error(self, where: Where, message: str) -> UniconError:
        """Return the error `file:line: message` for a value; its parent's line if it is absent."""
        return self._error_type(f"{self.where(where)}: {message}")


def read_yaml(path: Path, error_type: type[UniconError] = UniconError) -> Located:
    """Read a YAML file; duplicate keys are refused, since YAML itself silently keeps the last.

    Raises:
        UniconError: of type `error_type`: the file cannot be read or is not YAML.
    """
    located = Located(path, None, {(): 1}, error_type)
    try:
        root = compose(read_text(path, error_type))
        if root is not None:
            located.value = _value(root, (), located._lines)
    except YamlError as error:
        raise error_type(f"{path}:{error.line}: not valid YAML: {error.problem}") from error
    return located


def read_text(path: Path, error_type: type[UniconError] = UniconError) -> str:
    """Return the text of a file that may be a YAML document; one that is too large is not read.

    Raises:
        UniconError: of type `error_type`: the file cannot be read, or is too large.
    """
    try:
        with path.open("rb") as file:
            data = file.read(4 * MAX_SIZE + 1)
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise error_type(f"{path}: cannot be read: not UTF-8 text ({error})") from error
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise error_type(f"{path}: cannot be read: {reason}; give a readable YAML file") from error
    return text


def _value(node: Node, where: Where, lines: dict[Where, int]) -> Any:
    lines[where] = node.line
    if node.tag:
        raise YamlError(
            node.line, f"tag {node.tag!r} is not read; write plain values, lists and mappings"
        )
    if node.kind == "list":
        return [_value(item, (*where, i), lines) for i, item in enumerate(node.value)]
    if node.kind != "mapping":
        return node.value
    mapping: dict[Any, Any] = {}
    for key_node, value_node in node.value:
        key = _value(key_node, (*where, ""), {})
        if not isinstance(key, (str, int)):
            raise YamlError(key_node.line, f"key {key!r} is neither a word nor a number")
        here = (*where, key)
        if key in mapping:
            raise YamlError(
                key_node.line, f"key {key!r} stands twice, first in line {lines[here]}; remove one"
            )
        mapping[key] = _value(value_node, here, lines)
        # A long value starts below its key; an error about it belongs to the key's line.
        lines[here] = key_node.line
    return mapping
