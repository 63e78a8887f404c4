"""What other packages register through entry points, for whoever looks a name up."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib.metadata import EntryPoint, distribution, distributions

__all__ = ["all_registered", "registered"]


def registered(kind: str) -> Mapping[str, EntryPoint]:
    """Return name to entry point of a group; of two with one name the first found.

    Args:
        kind: `blocks`, `platforms`, `policies` or `faces`, whose group is `unicon.KIND`.
    """
    return all_registered().get(f"unicon.{kind}", {})


@cache
def all_registered() -> Mapping[str, Mapping[str, EntryPoint]]:
    """Return our groups, each a name to its entry point.

    Each installed package is looked at once, and parsed only where it names a group of ours:
    `entry_points(group=…)` looks at and parses all of them for each group, at 10 ms each.
    """
    found: dict[str, dict[str, EntryPoint]] = {}
    for each in distributions():
        text = each.read_text("entry_points.txt")
        if not text or "[unicon." not in text:
            continue
        if distribution(each.metadata["Name"]).read_text("entry_points.txt") != text:
            continue  # an older one, which the first of its name hides
        for entry in each.entry_points:
            found.setdefault(entry.group, {}).setdefault(entry.name, entry)
    return found
