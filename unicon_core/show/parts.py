"""The border between the parts of a divided workflow, as a table."""

from __future__ import annotations

from typing import TYPE_CHECKING

from unicon_core.aligned import aligned
from unicon_core.states import States

if TYPE_CHECKING:
    from unicon_core.workflow.parts import Parts

PARTS_HEAD = ("part", "group", "bytes", "published at", "states", "others silent")


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
