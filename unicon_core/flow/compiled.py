"""CompiledGraph: the functions of a tree and what they remember; for runner and replays."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import CellType, FunctionType

from unicon_base.arrays import Int64
from unicon_core.flow.block import Block
from unicon_core.flow.scope import LABEL

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
        found: dict[str, CellType] = {}
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
