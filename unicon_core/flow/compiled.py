"""CompiledGraph: the functions of a tree and what they remember; for runner and replays."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import CellType, FunctionType

import numpy as np
from numpy.typing import NDArray

from unicon_core.flow.block import Block
from unicon_core.flow.scope import LABEL

__all__ = ["CompiledGraph"]


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
    """

    step: Callable[[], bool]
    deferred: Callable[[], bool]
    warm_up: Callable[[], None]
    reset: Callable[[], None]
    source: str
    blocks: tuple[Block, ...]
    deferred_blocks: frozenset[int]
    stamps: NDArray[np.int64]

    def memory(self) -> dict[str, int]:
        """Return the variables that live from tick to tick: where chains and switches are."""
        return {name: cell.cell_contents for name, cell in self._counters().items()}

    def restore(self, memory: Mapping[str, int]) -> None:
        """Go on where another graph of the same tree was, between two ticks.

        Raises:
            ValueError: it is of another tree.
        """
        counters = self._counters()
        if set(memory) != set(counters):
            raise ValueError("the flow is another one")
        for name, cell in counters.items():
            cell.cell_contents = memory[name]

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
                    found[name] = cell
                else:
                    todo.append(cell.cell_contents)
        return found
