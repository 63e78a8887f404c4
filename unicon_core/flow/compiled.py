"""CompiledGraph: the functions of a tree and what they remember; Scope: the names in their code."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from types import CellType, FunctionType
from typing import Any, TypeAlias

from unicon_base.arrays import Int64
from unicon_base.generated import define
from unicon_core.flow.block import Block

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
        counters: kind and `id` of an owner to the name of the owner's variable.
    """

    names: dict[str, Any] = field(default_factory=dict)
    state: dict[str, int] = field(default_factory=dict)
    functions: list[tuple[str, Lines]] = field(default_factory=list)
    _bound: dict[tuple[str, int], str] = field(default_factory=dict)
    counters: dict[tuple[str, int], str] = field(default_factory=dict)
    _temporaries: int = 0

    def bind(self, prefix: str, value: Any, label: str = "") -> str:
        """Return the name of an object, made from prefix, a number and what fits of the label."""
        key = (prefix, id(value))
        if key not in self._bound:
            clean = re.sub(r"\W", "_", label, flags=re.ASCII)
            self._bound[key] = f"{prefix}{len(self.names)}" + (f"_{clean}" if clean else "")
            self.names[self._bound[key]] = value  # held here, so its id is not given away again
        return self._bound[key]

    def renamed(self, text: str, values: Mapping[str, Any]) -> str:
        """Return code with the names of `values` bound here; attributes stay."""
        return _WORD.sub(
            lambda w: self.bind("i", values[w[0]], w[0]) if w[0] in values else w[0], text
        )

    def counter(self, prefix: str, owner: object, initial: int = 0) -> str:
        """Return the name of an owner's variable, made on first use; the owner must stay alive."""
        key = (prefix, id(owner))
        if key not in self.counters:
            self.counters[key] = self.variable(prefix, initial)
        return self.counters[key]

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
        return source, define(source, {}, LABEL)["build"](**self.names)


def indent(lines: Lines, levels: int = 1) -> Lines:
    """Return lines further to the right."""
    return ["    " * levels + line for line in lines]


PLACED = ("chain", "case")
"""Kinds of the variables that tell which child of a chain or switch runs."""

WITHIN = ("due", "ending", "anew")
"""Variables that tell `deferred` what `step` put off: they are 0 between two ticks."""


@dataclass
class CompiledGraph:
    """The flat functions of a graph.

    Attributes:
        step: one tick up to and including `send`; True when the graph is done.
        deferred: the rest of the same tick; call it once after each `step`. True when a
            `Deferred(…, ends=True)` was done, which ends the graph like a true `step`.
        warm_up: calls `warm_up` of the blocks that have one and that `step` would run next; changes
            nothing observable.
        reset: makes the whole graph fresh, between two ticks or instead of `deferred`.
        source: the generated Python text.
        blocks: blocks in the order of their trace columns.
        deferred_blocks: those of `blocks` that run in `deferred`.
        stamps: int64 ns, shape (2 + len(blocks),): start of `step`, start of `deferred`, then the
            end of each block; 0 where it did not run. Empty without `trace`.
        detailed: each block has a stamp of its own.
        groups: the numbers of the blocks that share a stamp where not, in their order: that of the
            last one. The last group has none: it ends with the tick, as the ticker notes.
        places: `id` of a chain or switch to the variable of `save` that tells which of its
            children runs; less than 0 before the first one.
        shared: variables of `save` that lie in memory of native code: each has `cell_contents`.
    """

    step: Callable[[], bool]
    deferred: Callable[[], bool]
    warm_up: Callable[[], None]
    reset: Callable[[], None]
    source: str
    blocks: tuple[Block, ...]
    deferred_blocks: frozenset[int]
    stamps: Int64
    groups: tuple[tuple[int, ...], ...]
    _ways: Sequence[Callable[[], bool]]
    places: Mapping[int, str]
    detailed: bool = True
    shared: Mapping[str, Any] = field(default_factory=dict)

    def watch(self, each: bool) -> None:
        """Stamp each block from the next tick on, or `groups` of them alone, for next to nothing.

        The other stamps are 0 then, that of the start too; the last one of a group that did not run
        stays as it was.
        """
        self.detailed = each
        self.step, self.deferred = self._ways[:2] if each else self._ways[2:]
        self.stamps[:] = 0

    def save(self) -> dict[str, int]:
        """Return the variables that live from tick to tick: where chains and switches are.

        What says that something was put off is not among them: it is 0 between two ticks.
        """
        return {name: cell.cell_contents for name, cell in self._counters().items()}

    def cells(self, names: Iterable[str]) -> tuple[CellType, ...]:
        """Return what holds some variables of `save`, to look at them in every tick."""
        counters = self._counters()
        return tuple(counters[name] for name in names)

    def load(self, saved: Mapping[str, int]) -> None:
        """Go on where another graph of the same tree was, between two ticks.

        Raises:
            ValueError: it is of another tree.
        """
        counters = self._counters()
        own, theirs = _places(counters), _places(saved)
        if [kind for kind, _ in own] != [kind for kind, _ in theirs]:
            raise ValueError("the flow is another one")
        for (_, name), (_, their) in zip(own, theirs):
            counters[name].cell_contents = saved[their]

    def _counters(self) -> dict[str, CellType]:
        """Return the generated functions' own variables: all else that they enclose are objects."""
        found: dict[str, CellType] = {
            name: cell for name, cell in self.shared.items() if _kind(name) not in WITHIN
        }
        todo: list[object] = [self.step, self.deferred, self.reset]
        seen: set[int] = set()
        while todo:
            function = todo.pop()
            if not isinstance(function, FunctionType) or id(function) in seen:
                continue
            if function.__code__.co_filename != LABEL:
                continue
            seen.add(id(function))
            for name, cell in zip(function.__code__.co_freevars, function.__closure__ or ()):
                if type(cell.cell_contents) is int:
                    if _kind(name) not in WITHIN:
                        found[name] = cell
                else:
                    todo.append(cell.cell_contents)
        return found


def _kind(name: str) -> str:
    return name.rstrip("0123456789")


def _places(names: Iterable[str]) -> list[tuple[str, str]]:
    """Return kind and name of the variables between ticks, each kind in the order of the tree.

    Numbers count all variables: they are others where a hook gives other blocks, which may be put
    off. Memories of older records name what was put off, too.
    """
    told = [name for name in map(str, names) if _kind(name) not in WITHIN]
    return sorted(((_kind(n), n) for n in told), key=lambda p: (p[0], int(p[1][len(p[0]) :] or 0)))
