"""The state table: each state with its meaning, who writes it and who reads it."""

from __future__ import annotations

from unicon_core.flow import Node, blocks_of
from unicon_core.show.tree import shortened
from unicon_core.states import States

__all__ = ["shape_text", "state_rows"]


def shape_text(shape: tuple[int, ...]) -> str:
    """Return a shape as tables show it, such as `4×12`."""
    return "×".join(map(str, shape)) or "scalar"


def state_rows(root: Node, states: States) -> list[tuple[str, ...]]:
    """Return the heads, then a row for each state, in the order of their declaration."""
    blocks = blocks_of(root)

    def users(name: str, attribute: str) -> list[str]:
        named = (block.name for block in blocks if name in getattr(block, attribute))
        return list(dict.fromkeys(named))

    rows: list[tuple[str, ...]] = [
        ("state", "shape", "dtype", "unit", "frame", "writer", "readers", "description")
    ]
    for name, spec in states.layout.specs.items():
        amenders = [f"{user} (amends)" for user in users(name, "amends")]
        rows.append(
            (
                name,
                shape_text(states[name].shape),
                spec.dtype,
                spec.unit or "-",
                spec.frame or "-",
                shortened(users(name, "writes") + amenders, 4) or "-",
                shortened(users(name, "reads"), 4) or "-",
                spec.description,
            )
        )
    return rows
