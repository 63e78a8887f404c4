"""Configurations that are classes in Python, as legged_gym and humanoid-gym have them, as data.

Nothing is run: of each class the literals and the classes within are taken, and those of base
classes in the same file. What a base class of another file says, or what is computed, is not said.
"""

from __future__ import annotations

import ast
from pathlib import Path
from typing import TypeAlias

from unicon_base import AnyDict, PolicyError
from unicon_base.errors import one_line
from unicon_base.located_yaml import Located, Where, read_text
from unicon_core.policies.importers.formats import configuration_reader

_Class: TypeAlias = tuple[AnyDict, dict[Where, int]]
_WRONG = (SyntaxError, ValueError, TypeError, MemoryError, RecursionError)


def read_python(path: Path) -> Located:
    """Return the one class of a file that is a known configuration, as nested mappings.

    Raises:
        PolicyError: the file cannot be read, or has none or several of them.
    """
    try:
        tree = ast.parse(read_text(path, PolicyError))
    except _WRONG as error:
        text = f"no Python: {one_line(error)}; give the file of the configuration"
        raise PolicyError(f"{path}: {text}") from error
    known: dict[str, _Class] = {}
    for node in tree.body:
        if isinstance(node, ast.ClassDef):
            _read(node, node.name, known)
    found = {
        name: made
        for name, made in known.items()
        if "." not in name and configuration_reader(made[0]) is not None
    }
    if len(found) != 1:
        names = ", ".join(found) or "none"
        text = f"has {len(found)} configurations of legged_gym or humanoid-gym ({names})"
        raise PolicyError(f"{path}: it {text}; leave one in a copy")
    ((values, lines),) = found.values()
    return Located(path, values, lines, PolicyError)


def _read(node: ast.ClassDef, name: str, known: dict[str, _Class]) -> _Class:
    """Return a class's literals and their lines; `known` gets it, and the classes within."""
    values: AnyDict = {}
    lines: dict[Where, int] = {}
    for base in node.bases:
        more, places = known.get(ast.unparse(base), ({}, {}))
        values, lines = values | more, lines | places
    lines[()] = node.lineno
    for item in node.body:
        match item:
            case ast.ClassDef(name=key):
                values[key], places = _read(item, f"{name}.{key}", known)
                lines |= {(key, *where): line for where, line in places.items()}
            case (
                ast.Assign(targets=[ast.Name(id=key)], value=ast.expr() as value)
                | ast.AnnAssign(target=ast.Name(id=key), value=ast.expr() as value)
            ):
                values.pop(key, None)
                try:
                    values[key] = ast.literal_eval(value)
                except _WRONG:  # computed
                    continue
                lines[(key,)] = item.lineno
    known[name] = values, lines
    return values, lines
