"""The state table: each state with its meaning, who writes it and who reads it."""

from __future__ import annotations

from dataclasses import dataclass

from unicon_core.aligned import aligned
from unicon_core.flow import Node, blocks_of
from unicon_core.show.tree import shortened
from unicon_core.states import States

__all__ = ["HEAD", "StateRow", "shape_text", "state_rows", "state_table"]

HEAD = ("state", "shape", "dtype", "unit", "frame", "writer", "readers", "description")


def shape_text(shape: tuple[int, ...]) -> str:
    """Return a shape as tables show it, such as `4×12`."""
    return "×".join(map(str, shape)) or "scalar"


@dataclass(frozen=True)
class StateRow:
    """One state: its specification and the names of the blocks that use it."""

    name: str
    shape: tuple[int, ...]
    dtype: str
    unit: str
    frame: str
    writers: tuple[str, ...]
    amenders: tuple[str, ...]
    readers: tuple[str, ...]
    description: str

    def cells(self) -> tuple[str, ...]:
        """Return the row as texts, in the order of HEAD."""
        writers = [*self.writers, *(f"{name} (amends)" for name in self.amenders)]
        return (
            self.name,
            shape_text(self.shape),
            self.dtype,
            self.unit or "-",
            self.frame or "-",
            shortened(writers, 4) or "-",
            shortened(self.readers, 4) or "-",
            self.description,
        )


def state_rows(root: Node, states: States) -> list[StateRow]:
    """Return one row for each state, in the order of their declaration."""
    blocks = blocks_of(root)

    def users(name: str, attribute: str) -> tuple[str, ...]:
        named = (block.name for block in blocks if name in getattr(block, attribute))
        return tuple(dict.fromkeys(named))

    return [
        StateRow(
            name,
            states[name].shape,
            spec.dtype,
            spec.unit,
            spec.frame,
            users(name, "writes"),
            users(name, "amends"),
            users(name, "reads"),
            spec.description,
        )
        for name, spec in states.layout.specs.items()
    ]


def state_table(root: Node, states: States) -> str:
    """Return the table as aligned text."""
    return "\n".join(aligned([HEAD, *(row.cells() for row in state_rows(root, states))]))
