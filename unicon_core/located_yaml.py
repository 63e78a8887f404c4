"""YAML with the line of every value, so that an error can name `file:line`, for every loader."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from unicon_core.errors import UniconError

__all__ = ["Loader", "Located", "parse_value", "read_yaml"]

Where = tuple[str | int, ...]


class Loader(yaml.SafeLoader):
    """A loader with the words of YAML 1.2, where `on`, `off`, `yes` and `no` are plain words.

    In YAML 1.1, which PyYAML reads, `on:` is the key True and `1e-3` a text: both have bitten.
    """


Loader.yaml_implicit_resolvers = {
    first: [
        (tag, pattern)
        for tag, pattern in resolvers
        if tag not in ("tag:yaml.org,2002:bool", "tag:yaml.org,2002:float")
    ]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
Loader.add_implicit_resolver(
    "tag:yaml.org,2002:bool", re.compile(r"^(?:true|True|TRUE|false|False|FALSE)$"), list("tTfF")
)
Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(
        r"""^(?:[-+]?(?:\.[0-9]+|[0-9]+\.[0-9]*)(?:[eE][-+]?[0-9]+)?
        |[-+]?[0-9]+[eE][-+]?[0-9]+
        |[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$""",
        re.VERBOSE,
    ),
    list("-+0123456789."),
)


def parse_value(text: str) -> Any:
    """Return the value of a short text, such as what follows `=` in `--set`.

    Raises:
        yaml.YAMLError: it is not YAML.
    """
    return yaml.load(text, Loader)


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
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise error_type(f"{path}: cannot be read: {error}") from error
    try:
        loader = Loader(text)
        root = loader.get_single_node()
        located = Located(path, None, {(): 1}, error_type)
        if root is not None:
            located.value = _value(loader, root, (), located)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = mark.line + 1 if mark else 1
        raise error_type(f"{path}:{line}: not valid YAML: {_problem(error)}") from error
    except yaml.YAMLError as error:
        raise error_type(f"{path}: not valid YAML: {' '.join(str(error).split())}") from error
    return located


def _problem(error: yaml.MarkedYAMLError) -> str:
    """Return what is wrong, with the line of the bracket or quote that was left open."""
    begun = error.context_mark
    if begun is None or error.problem_mark is None or begun.line == error.problem_mark.line:
        return str(error.problem)
    return f"{error.problem} ({error.context}, which begins in line {begun.line + 1})"


def _value(loader: yaml.SafeLoader, node: yaml.Node, where: Where, located: Located) -> Any:
    located._lines[where] = node.start_mark.line + 1
    if isinstance(node, yaml.SequenceNode):
        return [_value(loader, item, (*where, i), located) for i, item in enumerate(node.value)]
    if isinstance(node, yaml.MappingNode):
        mapping: dict[Any, Any] = {}
        for key_node, value_node in node.value:
            key = loader.construct_object(key_node, deep=True)
            if not isinstance(key, (str, int)):
                raise yaml.constructor.ConstructorError(
                    None, None, f"key {key!r} is neither a word nor a number", key_node.start_mark
                )
            here = (*where, key)
            if key in mapping:
                first = located._lines[here]
                raise yaml.constructor.ConstructorError(
                    None,
                    None,
                    f"key {key!r} stands twice, first in line {first}; remove one",
                    key_node.start_mark,
                )
            mapping[key] = _value(loader, value_node, here, located)
            # A long value starts below its key; an error about it belongs to the key's line.
            located._lines[here] = key_node.start_mark.line + 1
        return mapping
    return loader.construct_object(node, deep=True)
