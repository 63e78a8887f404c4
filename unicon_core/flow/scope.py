"""Scope: the names and functions of generated code, for the compiler."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from unicon_base.generated import define

Lines: TypeAlias = list[str]

LABEL = "<unicon graph>"
"""What Python calls generated code in a trace."""

_WORD = re.compile(r"(?<![\w.])[A-Za-z_]\w*")


@dataclass
class Scope:
    """What stands around the generated functions.

    Attributes:
        names: bound objects, parameters of the function around all others.
        state: variables that live from tick to tick, with their initial values.
        functions: name and body of each function.
    """

    names: dict[str, Any] = field(default_factory=dict)
    state: dict[str, int] = field(default_factory=dict)
    functions: list[tuple[str, Lines]] = field(default_factory=list)
    _bound: dict[tuple[str, int], str] = field(default_factory=dict)
    _counters: dict[tuple[str, int], str] = field(default_factory=dict)
    _temporaries: int = 0

    def bind(self, prefix: str, value: Any, label: str = "") -> str:
        """Return the name of an object, made from prefix, a number and what fits of the label."""
        key = (prefix, id(value))
        if key not in self._bound:
            clean = "".join(c if c.isalnum() and c.isascii() else "_" for c in label)
            self._bound[key] = f"{prefix}{len(self.names)}" + (f"_{clean}" if clean else "")
            self.names[self._bound[key]] = value  # held here, so its id is not given away again
        return self._bound[key]

    def renamed(self, text: str, values: Mapping[str, Any]) -> str:
        """Return code with the names of `values` bound here; attributes stay."""

        def replace(match: re.Match[str]) -> str:
            word = match[0]
            return self.bind("i", values[word], word) if word in values else match[0]

        return _WORD.sub(replace, text)

    def counter(self, prefix: str, owner: object, initial: int = 0) -> str:
        """Return the name of an owner's variable, made on first use; the owner must stay alive."""
        key = (prefix, id(owner))
        if key not in self._counters:
            self._counters[key] = self.variable(prefix, initial)
        return self._counters[key]

    def has_counter(self, prefix: str, owner: object) -> bool:
        """Return True where the owner's variable was asked for before."""
        return (prefix, id(owner)) in self._counters

    def places(self, *prefixes: str) -> dict[int, str]:
        """Return `id` of each owner to the name of its variable with one of these prefixes."""
        return {owner: name for (kind, owner), name in self._counters.items() if kind in prefixes}

    def variable(self, prefix: str, initial: int = 0) -> str:
        """Return the name of a new variable that lives from tick to tick."""
        name = f"{prefix}{len(self.state)}"
        self.state[name] = initial
        return name

    def temporary(self, prefix: str) -> str:
        """Return a new name inside one function."""
        self._temporaries += 1
        return f"{prefix}{self._temporaries}"

    def outline(self, prefix: str, lines: Lines) -> str:
        """Put lines into a function of their own and return the call."""
        name = f"{prefix}{len(self.functions)}"
        self.functions.append((name, lines))
        return f"{name}()"

    def build(self, *exported: str) -> tuple[str, tuple[Callable[..., Any], ...]]:
        """Return the text of all functions, and those of the given names, ready to call."""
        nonlocals = [f"nonlocal {', '.join(self.state)}"] if self.state else []
        lines = [
            f"def build({', '.join(self.names)}):",
            *(f"    {name} = {value}" for name, value in self.state.items()),
        ]
        for name, body in self.functions:
            lines += [f"    def {name}():", *indent([*nonlocals, *(body or ["pass"])], 2)]
        source = "\n".join([*lines, f"    return {', '.join(exported)}", ""])
        namespace = define(source, {}, LABEL)
        return source, namespace["build"](**self.names)


def indent(lines: Lines, levels: int = 1) -> Lines:
    """Return lines further to the right."""
    return ["    " * levels + line for line in lines]
