"""YAML with the line of every value, for policy files; foreign `!!python/…` tags are kept inert.

Training tools dump Python objects into their YAML (`!!python/object/apply:builtins.slice`,
`!!python/tuple`). Nothing of that is ever built here: a tuple becomes a list and any other tag a
`Tagged` value that only holds what was written.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from unicon_core.errors import PolicyError

__all__ = ["Tagged", "Where", "read_yaml"]

Where = tuple[str | int, ...]

# libyaml where PyYAML was built with it: a deploy.yaml in 1 ms instead of 7.
_Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
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
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise PolicyError(f"{path}: cannot be read: {reason}; give a readable YAML file") from error
    lines: dict[Where, int] = {(): 1}
    try:
        loader = _Loader(text)
        root = loader.get_single_node()
        value = None if root is None else _Reader(path, loader, lines).value(root, ())
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = mark.line + 1 if mark else 1
        raise PolicyError(f"{path}:{line}: not valid YAML: {error.problem}") from error
    except yaml.YAMLError as error:
        raise PolicyError(f"{path}: not valid YAML: {' '.join(str(error).split())}") from error
    return value, lines


class _Reader:
    def __init__(self, path: Path, loader: Any, lines: dict[Where, int]) -> None:
        self.path = path
        self.loader = loader
        self.lines = lines

    def value(self, node: yaml.Node, where: Where) -> Any:
        self.lines.setdefault(where, node.start_mark.line + 1)
        content: Any
        if isinstance(node, yaml.SequenceNode):
            content = [self.value(item, (*where, i)) for i, item in enumerate(node.value)]
        elif isinstance(node, yaml.MappingNode):
            content = self.mapping(node, where)
        else:
            content = self.scalar(node)
        if node.tag.startswith(_PYTHON) and node.tag not in _SEQUENCES + _SCALARS:
            return Tagged(node.tag.removeprefix(_PYTHON), content)
        return content

    def scalar(self, node: yaml.Node) -> Any:
        if node.tag.startswith(_PYTHON):
            implicit = self.loader.resolve(yaml.ScalarNode, node.value, (True, False))
            plain = yaml.ScalarNode(implicit, node.value, node.start_mark, node.end_mark)
            return self.loader.construct_object(plain)
        return self.loader.construct_object(node, deep=True)

    def mapping(self, node: yaml.MappingNode, where: Where) -> dict[Any, Any]:
        result: dict[Any, Any] = {}
        for key_node, value_node in node.value:
            line = key_node.start_mark.line + 1
            key = self.loader.construct_object(key_node, deep=True)
            if not isinstance(key, (str, int, float, bool, type(None))):
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
