"""Tables: each state, who writes and who reads it; and what the parts of a workflow publish."""

from __future__ import annotations

from typing import TYPE_CHECKING

from unicon_core.flow import Node, blocks_of
from unicon_core.show.tree import shortened
from unicon_core.states import Layout, States
from unicon_core.text_table import aligned

if TYPE_CHECKING:
    from unicon_core.workflow.parts import Parts

SPEC_HEAD = ("state", "shape", "dtype", "unit", "frame")
PARTS_HEAD = ("part", "group", "bytes", "published at", "states", "others silent")


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


def parts_table(parts: Parts, states: States) -> list[str]:
    """Return `parts_rows` as lines of text."""
    return aligned(parts_rows(parts, states))


def parts_rows(parts: Parts, states: States) -> list[tuple[str, ...]]:
    """Return the heads, then what each part publishes, where, and when the others are silent."""
    rows: list[tuple[str, ...]] = [PARTS_HEAD]
    for part in parts.parts.values():
        silent = f"{part.silent.then} after {part.silent.after:g} s"
        groups = parts.groups(part.name, states.layout)
        for k, (name, group) in enumerate(groups.items()):
            store = parts.store
            place = (
                store.segment(part.name) if store.backend == "shm" else store.place(part.name, k)
            )
            where = f"{store.backend} {place}"
            size = f"{group.nbytes} B"
            rows.append((part.name, name, size, where, " ".join(group.specs), silent))
        if not groups:
            rows.append((part.name, "-", "-", "-", "-", silent))
    return rows
