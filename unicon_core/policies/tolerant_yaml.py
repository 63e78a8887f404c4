"""YAML with the line of every value, for policy files; foreign `!!python/…` tags are kept inert.

Training tools dump Python objects into their YAML (`!!python/object/apply:builtins.slice`,
`!!python/tuple`). Nothing of that is ever built here: a tuple becomes a list and any other tag a
`Tagged` value that only holds what was written.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from unicon_core.bounded_yaml import Node, YamlError, compose, plain
from unicon_core.errors import PolicyError
from unicon_core.located_yaml import read_text

__all__ = ["Tagged", "Where", "read_yaml"]

Where = tuple[str | int, ...]

_PYTHON = "tag:yaml.org,2002:python/"
_SEQUENCES = (f"{_PYTHON}tuple", f"{_PYTHON}list")
_SCALARS = tuple(f"{_PYTHON}{name}" for name in ("int", "float", "bool", "str", "none", "unicode"))


@dataclass(frozen=True)
class Tagged:
    """A value with a tag that is not plain YAML: what it was called and what stood there."""

    tag: str
    value: Any


def read_yaml(path: Path) -> tuple[Any, dict[Where, int]]:
    """Read a YAML file safely; a key that stands twice is refused with both values.

    Args:
        path: the file.

    Returns:
        The document, and the line (from 1) of each value by its path of keys.

    Raises:
        PolicyError: the file cannot be read, is not YAML, or has a key twice.
    """
    lines: dict[Where, int] = {(): 1}
    try:
        root = compose(read_text(path, PolicyError))
        value = None if root is None else _Reader(path, lines).value(root, ())
    except YamlError as error:
        raise PolicyError(f"{path}:{error.line}: not valid YAML: {error.problem}") from error
    return value, lines


class _Reader:
    def __init__(self, path: Path, lines: dict[Where, int]) -> None:
        self.path = path
        self.lines = lines

    def value(self, node: Node, where: Where) -> Any:
        self.lines.setdefault(where, node.line)
        if node.kind == "list":
            content: Any = [self.value(item, (*where, i)) for i, item in enumerate(node.value)]
        elif node.kind == "mapping":
            content = self.mapping(node, where)
        else:
            content = node.value
        if not node.tag or node.tag in _SEQUENCES:
            return content
        if node.tag in _SCALARS and node.kind == "scalar":
            return plain(content, node.line)
        return Tagged(node.tag.removeprefix(_PYTHON), content)

    def mapping(self, node: Node, where: Where) -> dict[Any, Any]:
        result: dict[Any, Any] = {}
        for key_node, value_node in node.value:
            line = key_node.line
            key = key_node.value if key_node.kind == "scalar" else None
            if not isinstance(key, (str, int, float, bool)) or key_node.tag:
                raise PolicyError(f"{self.path}:{line}: key {key!r} is not a word; write a word")
            place = (*where, key if isinstance(key, int) else str(key))
            if key in result:
                again = self.value(value_node, (*place, "again"))
                raise PolicyError(
                    f"{self.path}:{line}: key {key!r} stands twice: {result[key]!r} (line "
                    f"{self.lines[place]}) and {again!r}; remove one"
                )
            self.lines[place] = line
            result[key] = self.value(value_node, place)
        return result
