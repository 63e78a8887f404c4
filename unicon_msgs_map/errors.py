"""The errors of the message map, for everybody who writes, loads or builds a mapping.

    MapError                   base: a `UniconError`, one clear line
    ├── MapFileError           a mapping file is wrong (carries file, line and entry)
    ├── MessageTypeError       a message type is unknown or cannot be laid out
    ├── MapStateError          a state or a variable is unknown, or its size or dtype does not fit
    └── MapDependencyError     rosbags or PyYAML is absent (names the install command)

All of them are raised while a mapping is loaded or built. `encode` and `decode` raise none: a
payload that cannot be read is counted and described by the decoder instead.
"""

from __future__ import annotations

from unicon_base import UniconError


class MapError(UniconError):
    """Base of every error of this package; `where` is `file:line: entry` of the culprit."""


class MapFileError(MapError):
    """A mapping file cannot be read or says something that it must not."""


class MessageTypeError(MapError):
    """A message type is unknown, malformed, or has a field that CDR layouts here do not cover."""


class MapStateError(MapError):
    """A state or variable is unknown, or its size or dtype does not fit the message field."""


class MapDependencyError(MapError):
    """An optional package is absent; the message ends with the command that installs it."""


def count_of(count: int) -> str:
    """Return `1 element`, `2 elements`."""
    return f"{count} element" if count == 1 else f"{count} elements"
