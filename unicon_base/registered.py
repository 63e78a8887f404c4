"""What other packages register through entry points, for whoever looks a name up."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from importlib.metadata import EntryPoint, distribution, distributions
from pathlib import Path
from typing import Any

from unicon_base.errors import UniconError


def registered(kind: str) -> Mapping[str, EntryPoint]:
    """Return name to entry point of a group; of two with one name the first found.

    Args:
        kind: `blocks`, `platforms`, `policies`, `faces`, `config`, `commands` or `run`, whose
            group is `unicon.KIND`.
    """
    return all_registered().get(f"unicon.{kind}", {})


NEEDED = {"commands": ("add",), "run": ("OPTIONS", "CHECKS", "refuse", "attachments")}
"""What an object of a group has."""


@cache
def loaded(kind: str) -> Mapping[str, Any]:
    """Return name to object of a group, by name; without those whose package was removed.

    Another package that is broken is named on standard error and left out.

    Args:
        kind: a key of `NEEDED`.
    """
    found: dict[str, Any] = {}
    for name, entry in sorted(registered(kind).items()):
        try:
            each = entry.load()
            lacking = [repr(word) for word in NEEDED[kind] if not hasattr(each, word)]
            why = f"it has no {', '.join(lacking)}" if lacking else ""
        except Exception as wrong:  # whatever another package's code raises
            gone = wrong.name or "?" if isinstance(wrong, ModuleNotFoundError) else "?"
            if f"{entry.module}.".startswith(f"{gone}."):
                continue
            why = f"{type(wrong).__name__}: {wrong}".splitlines()[0]
        if not why:
            found[name] = each
            continue
        with suppress(OSError):
            print(
                f"unicon: warning: unicon.{kind} {name!r} (entry point {entry.value}) is left out: "
                f"{why}; mend or uninstall its package",
                file=sys.stderr,
            )
    return found


def path_of(entry: EntryPoint, what: str, error: type[UniconError]) -> Path | None:
    """Return the folder or file that an entry point names; None where its function says so.

    Args:
        entry: its value is a path (text or `Path`), a function without parameters that returns
            one, or a package, whose folder is meant. It is imported.
        what: for the message, such as `"policy 'walk'"`.
        error: the class to raise.

    Raises:
        error: its module cannot be imported, or it gives no path that exists.
    """
    label = f"{what} (entry point {entry.value})"
    try:
        value = entry.load()
        if callable(value) and (value := value()) is None:
            return None
    except Exception as wrong:  # whatever another package's code raises
        reason = f"{type(wrong).__name__}: {wrong}".splitlines()[0]
        raise error(f"{label}: {reason}; install its package again") from wrong
    if hasattr(value, "__path__"):  # a package
        value = next(iter(value.__path__), None)
    if not isinstance(value, (str, os.PathLike)):
        raise error(
            f"{label}: its value is of type {type(value).__name__}; it must be the path of a "
            "folder or file, or a function that returns one"
        )
    path = Path(value)
    if not os.path.exists(path):
        raise error(f"{label}: no such path {path}; install its package again")
    return path.resolve()


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
