"""The errors of the message map, for everybody who writes, loads or builds a mapping.

    MapError                   base: one clear line
    ├── MapFileError           a mapping file is wrong (carries file, line and entry)
    ├── MessageTypeError       a message type is unknown or cannot be laid out
    ├── MapStateError          a state or a variable is unknown, or its size or dtype does not fit
    └── MapDependencyError     rosbags or PyYAML is absent (names the install command)

All of them are raised while a mapping is loaded or built. `encode` and `decode` raise none: a
payload that cannot be read is counted and described by the decoder instead.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable

__all__ = [
    "MapDependencyError",
    "MapError",
    "MapFileError",
    "MapStateError",
    "MessageTypeError",
    "alternatives",
    "count_of",
]


class MapError(Exception):
    """Base of every error of this package; `str()` is the one line to print.

    Args:
        message: what is wrong, with alternatives and remedy.
        where: `file:line: entry` of the culprit, put in front of the message where known.
    """

    def __init__(self, message: str, where: str | None = None) -> None:
        super().__init__(f"{where}: {message}" if where else message)
        self.message = message
        self.where = where

    def __str__(self) -> str:
        # A name of a file may hold anything, and an error stays one line for all that.
        return " ".join(super().__str__().split("\n"))


class MapFileError(MapError):
    """A mapping file cannot be read or says something that it must not."""


class MessageTypeError(MapError):
    """A message type is unknown, malformed, or has a field that CDR layouts here do not cover."""


class MapStateError(MapError):
    """A state or variable is unknown, or its size or dtype does not fit the message field."""


class MapDependencyError(MapError):
    """An optional package is absent; the message ends with the command that installs it."""


def alternatives(wrong: str, known: Iterable[str], *, limit: int = 12) -> str:
    """Return a phrase that names what else there is: the close match first, then the list.

    Args:
        wrong: the name that was not found.
        known: the names that exist.
        limit: how many names to list at most.
    """
    names = sorted(map(str, known))
    if not names:
        return "none is known"
    close = difflib.get_close_matches(str(wrong)[:80], names, n=1)
    shown = ", ".join(names[:limit]) + (f", … ({len(names)} in all)" if len(names) > limit else "")
    return f"did you mean {close[0]!r}? known: {shown}" if close else f"known: {shown}"


def count_of(count: int) -> str:
    """Return `1 element`, `2 elements`."""
    return f"{count} element" if count == 1 else f"{count} elements"
