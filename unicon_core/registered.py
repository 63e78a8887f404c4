"""What other packages register through entry points, for whoever looks a name up."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points

__all__ = ["registered"]


@lru_cache(maxsize=4)
def registered(kind: str) -> Mapping[str, EntryPoint]:
    """Return name to entry point of a group; of two with one name the first found.

    Args:
        kind: `blocks`, `platforms`, `policies` or `faces`, whose group is `unicon.KIND`.
    """
    found: dict[str, EntryPoint] = {}
    for entry in entry_points(group=f"unicon.{kind}"):
        found.setdefault(entry.name, entry)
    return found
