"""YAML with the line of every value, so that an error can name `file:line`: for every reader.

Workflows, robots, policies and message maps are read here and nowhere else. Training tools dump
Python objects into their YAML (`!!python/object/apply:builtins.slice`, `!!python/tuple`); who reads
such files says `foreign`. Nothing of that is ever built: a tuple becomes a list, and any other tag
a `Tagged` value that only holds what was written. A loader that was handed another kind of file, or
a pointer of Git LFS, learns it here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from unicon_base import UniconError
from unicon_base.bounded_yaml import MAX_SIZE, Node, YamlError, compose, plain

Where = tuple[str | int, ...]

_PYTHON = "tag:yaml.org,2002:python/"
_SEQUENCES = (f"{_PYTHON}tuple", f"{_PYTHON}list")
_SCALARS = tuple(f"{_PYTHON}{name}" for name in ("int", "float", "bool", "str", "none", "unicode"))


@dataclass(frozen=True)
class Tagged:
    """A value with a tag that is not plain YAML: what it was called and what stood there."""

    tag: str
    value: Any


class Located:
    """A document and the line of each of its values.

    Args:
        path: the file, as it is to be named in messages.
        value: the document.
        lines: line (from 1) of each value; keys are paths such as `("joints", 3, "lower")`. What
            stands below its key has the key's line.
        error_type: the class of its errors, made of a message and a place.
    """

    def __init__(
        self,
        path: str | Path,
        value: Any,
        lines: dict[Where, int],
        error_type: type[UniconError] = UniconError,
    ) -> None:
        self.path = Path(path)
        self.value = value
        self.lines = lines
        self._error_type = error_type

    def where(self, where: Where) -> str:
        """Return `file:line` of a value; its parent's line if it is absent."""
        while where and where not in self.lines:
            where = where[:-1]
        return f"{self.path}:{self.lines.get(where, 1)}"

    def error(self, where: Where, message: str) -> UniconError:
        """Return the error `file:line: message` for a value; its parent's line if it is absent."""
        return self._error_type(message, self.where(where))


def read_yaml(
    path: Path, error_type: type[UniconError] = UniconError, *, foreign: bool = False
) -> Located:
    """Read a YAML file; duplicate keys are refused, since YAML itself silently keeps the last.

    Args:
        path: the file.
        error_type: the class of all errors about it.
        foreign: keep tags of Python objects as inert values instead of refusing them.

    Raises:
        UniconError: of type `error_type`: the file cannot be read or is not YAML.
    """
    return parse_yaml(read_text(path, error_type), path, error_type, foreign=foreign)


def parse_yaml(
    text: str,
    path: str | Path,
    error_type: type[UniconError] = UniconError,
    *,
    foreign: bool = False,
) -> Located:
    """Read the text of a YAML file, as `read_yaml` does; `path` names it in messages."""
    reader = _Reader(foreign)
    try:
        root = compose(text)
        value = None if root is None else reader.value(root, ())
    except YamlError as error:
        raise error_type(f"not valid YAML: {error.problem}", f"{path}:{error.line}") from error
    return Located(path, value, reader.lines, error_type)


def parse_value(text: str) -> Any:
    """Return the value of a short text, such as what follows `=` in `--set`.

    Raises:
        YamlError: it is not YAML, or beyond the bounds of `bounded_yaml`.
    """
    root = compose(text)
    return None if root is None else _Reader(foreign=False).value(root, ())


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


class _Reader:
    def __init__(self, foreign: bool) -> None:
        self.foreign = foreign
        self.lines: dict[Where, int] = {}

    def value(self, node: Node, where: Where) -> Any:
        # A long value starts below its key; an error about it belongs to the key's line.
        self.lines.setdefault(where, node.line)
        if node.tag and not self.foreign:
            raise YamlError(
                node.line, f"tag {node.tag!r} is not read; write plain values, lists and mappings"
            )
        content = node.value
        if node.kind == "list":
            content = [self.value(item, (*where, i)) for i, item in enumerate(node.value)]
        elif node.kind == "mapping":
            content = self.mapping(node, where)
        if not node.tag or node.tag in _SEQUENCES:
            return content
        if node.tag in _SCALARS and node.kind == "scalar":
            return plain(content, node.line)
        return Tagged(node.tag.removeprefix(_PYTHON), content)

    def mapping(self, node: Node, where: Where) -> dict[Any, Any]:
        mapping: dict[Any, Any] = {}
        for key_node, value_node in node.value:
            key = _Reader(self.foreign).value(key_node, ())
            if not isinstance(key, str | int) and not (self.foreign and isinstance(key, float)):
                raise YamlError(key_node.line, f"key {key!r} is neither a word nor a number")
            here = (*where, str(key) if isinstance(key, float) else key)
            if key in mapping:
                first = self.lines[here]
                raise YamlError(
                    key_node.line, f"key {key!r} stands twice, first in line {first}; remove one"
                )
            self.lines[here] = key_node.line
            mapping[key] = self.value(value_node, here)
        return mapping


_POINTER = b"version https://git-lfs"
_KINDS = {
    "workflow": "run it with `unicon run FILE`",
    "sweep": "run it with `unicon sweep FILE`",
    "robot": "name it as `robot: FILE` in a workflow, or see it with `unicon robots FILE`",
    "policy": "name its folder under `policies:` in a workflow",
}


def is_lfs_pointer(path: Path) -> bool:
    """Return whether a file only names what `git lfs pull` would bring; False of an unreadable."""
    try:
        with path.open("rb") as file:
            return file.read(len(_POINTER)) == _POINTER
    except OSError:  # its loader says so
        return False


def other_kind(values: Any, wanted: str) -> str:
    """Return that a document is of another kind and what is done with it, "" where it may be right.

    Args:
        values: the document; a workflow need not have a schema.
        wanted: `workflow`, `sweep`, `robot` or `policy`.
    """
    if not isinstance(values, Mapping):
        return ""
    is_flow = {"robot", "platform", "flow"} <= values.keys()
    schema = str(values.get("schema", "unicon.workflow/1" if is_flow else ""))
    kind = schema.removeprefix("unicon.").rpartition("/")[0]
    if kind not in _KINDS or kind == wanted:
        return ""
    return f"this file is a {kind}, not a {wanted}; {_KINDS[kind]}"
