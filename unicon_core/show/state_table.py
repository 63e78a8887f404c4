"""The state table: each state with its meaning, who writes it and who reads it."""

from __future__ import annotations

from unicon_core.flow import Node, blocks_of
from unicon_core.show.tree import shortened
from unicon_core.states import Layout, States

SPEC_HEAD = ("state", "shape", "dtype", "unit", "frame")


def spec_cells(layout: Layout, name: str) -> tuple[str, ...]:
    """Return what a state is, under the heads of SPEC_HEAD."""
    spec, shape = layout.specs[name], layout.slots[name].shape
    shape_text = "×".join(map(str, shape)) or "scalar"
    return (name, shape_text, spec.dtype, spec.unit or "-", spec.frame or "-")


def state_rows(root: Node, states: States, limit: int = 4) -> list[tuple[str, ...]]:
    """Return the heads, then a row for each state, in the order of their declaration.

    Args:
        root: the graph.
        states: all states.
        limit: so many writers and readers are named; the others are counted.
    """
    blocks = blocks_of(root)

    def users(name: str, attribute: str) -> list[str]:
        named = (block.name for block in blocks if name in getattr(block, attribute))
        return list(dict.fromkeys(named))

    rows: list[tuple[str, ...]] = [(*SPEC_HEAD, "writer", "readers", "description")]
    for name, spec in states.layout.specs.items():
        amenders = [f"{user} (amends)" for user in users(name, "amends")]
        rows.append(
            (
                *spec_cells(states.layout, name),
                shortened(users(name, "writes") + amenders, limit) or "-",
                shortened(users(name, "reads"), limit) or "-",
                spec.description,
            )
        )
    return rows
