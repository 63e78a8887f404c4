"""Marks: what a field of a document's class says beside its type, in `Annotated[TYPE, MARK, …]`."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, Any, NamedTuple


class Unit(NamedTuple):
    """Unit of a number, such as `rad/s`."""

    symbol: str


class Within(NamedTuple):
    """Bounds of a number; every number is finite but for an `endless` one.

    Attributes:
        low, high: the smallest and the largest allowed value.
        unit: such as `rad/s`.
        above: `low` itself is refused.
        endless: infinities are allowed.
    """

    low: float = -math.inf
    high: float = math.inf
    unit: str = ""
    above: bool = False
    endless: bool = False


def positive(high: float = math.inf, unit: str = "") -> Within:
    """Return the bounds of a number above 0."""
    return Within(0.0, high, unit, above=True)


class Key(NamedTuple):
    """Key in the file, where it is no Python name (`from`) or another word than the attribute."""

    name: str


class Size(NamedTuple):
    """How many entries a list or mapping has."""

    least: int = 0
    most: int | None = None


class Matches(NamedTuple):
    """Regular expression that a whole text matches.

    Attributes:
        pattern: as of `re.fullmatch`.
        wanted: the remedy's words, such as `a text`.
        longest: characters at most.
    """

    pattern: str
    wanted: str
    longest: int | None = None


class Write(NamedTuple):
    """An example for the remedy: `write {left_hand: {body: …}}`."""

    example: str


class Checked(NamedTuple):
    """A rule that a type cannot say.

    Attributes:
        wrong: takes the value as read and returns what is wrong ("is …; write …"), "" for nothing.
    """

    wrong: Callable[[Any], str]


class Like(NamedTuple):
    """A mapping that a class describes and that stays as it was written.

    Attributes:
        kind: dataclass of its keys.
        open: keys that the class does not know are allowed.
    """

    kind: type
    open: bool = False


class Made(NamedTuple):
    """What a function makes of a value.

    Attributes:
        function: takes the value; its `UniconError` ("is …; write …") is the mistake.
        of: hint that the value is read by first.
    """

    function: Callable[[Any], Any]
    of: Any = Any


class Later(NamedTuple):
    """A type whose module is imported when a document has the key.

    Attributes:
        target: `module:attribute`.
    """

    target: str


class NotAKey(NamedTuple):
    """Python's alone: a file does not say it."""


NAME = r"[A-Za-z0-9_][A-Za-z0-9_./:+-]*"

Text = Annotated[str, Matches(r"(?s).*\S.*", "a text")]
"""A text with a character that is no space."""

Name = Annotated[
    str,
    Matches(
        NAME, "a name of letters, digits and _ . / : + -, the first a letter, a digit or _", 255
    ),
]
"""A name of a joint, body or frame, which stands in URDF, TF and joint states as it is."""

NotEmpty = Size(1)


def twice(names: Any) -> str:
    """Return what is wrong with a list that names something twice, "" for nothing."""
    again = next((name for name in names if names.count(name) > 1), None)
    return "" if again is None else f"names {again!r} twice; name each once"


Names = Annotated[tuple[Text, ...], NotEmpty, Checked(twice), Write("a list of names")]
"""Names of joints, bodies or the like, each once."""


def _unit_length(quat: Any) -> str:
    length = math.hypot(*quat)
    if abs(length - 1.0) > 1e-3:
        return f"has length {length:.4g}; write a unit quaternion, w first"
    return ""


Metres = Annotated[float, Within(-10.0, 10.0, "m")]
"""A coordinate on a robot: none is larger than 10 m."""

Core = Annotated[int, Within(0, 1 << 16)]
"""Number of a core of the machine."""

Point = tuple[Metres, Metres, Metres]
"""x, y, z in [m]."""

Quat = Annotated[tuple[float, float, float, float], Checked(_unit_length)]
"""Unit quaternion wxyz."""
