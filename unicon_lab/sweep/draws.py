"""Draws: what a parameter of a sweep may be, and which value a point in [0, 1) stands for.

{range: [0, 99]}      whole numbers, both ends included
{linspace: [0, 1, 5]} so many numbers, evenly spaced
{uniform: [0, 1]}     any number between; {log_uniform: [0.1, 10]} evenly in its logarithm
{normal: [1.0, 0.1]}  mean and standard deviation, cut at four of them
[a, b, c]             one of these
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import yaml

from unicon_base import UniconError, alternatives
from unicon_base.bounded_yaml import YamlError
from unicon_base.located_yaml import parse_value

DIGITS = 6
"""Of a number that is drawn: few enough to be read and typed, and then the very same number."""
MOST_VALUES = 100_000
"""Of a list or range."""
CUT = 4.0
"""Standard deviations at which a normal distribution is cut: what is beyond is one in 16,000."""


@dataclass(frozen=True)
class Parameter:
    """One thing that a sweep varies.

    Attributes:
        path: as of `--set`.
        kind: of its values, one of `KINDS` or `list`.
        at: the value of a point in [0, 1).
        values: all that there are, None where they are not counted.
        words: what it may be, for people.
    """

    path: str
    kind: str
    at: Callable[[float], Any]
    values: tuple[Any, ...] | None
    words: str

    @property
    def type(self) -> type:
        """Of its values: int, float, or str for whatever is no number."""
        if self.values is None:
            return float
        types = set(map(type, self.values))
        return str if types - {int, float} else int if types == {int} else float


def parameter(path: str, said: Any) -> Parameter:
    """Return a parameter as a sweep file says it.

    Raises:
        UniconError: it is of no known form.
    """
    words = _one_line(said)[:200]
    if isinstance(said, list):
        return _listed(path, "list", said, words)
    if not isinstance(said, dict) or len(said) != 1:
        raise UniconError(f"is {said!r:.60}; write a list of values, or one of {_FORMS}")
    ((kind, of),) = said.items()
    if kind not in KINDS:
        raise UniconError(f"has no {kind!r}; {alternatives(str(kind), KINDS)}: {_FORMS}")
    count = 3 if kind == "linspace" else 2
    if not isinstance(of, list) or len(of) != count or not all(map(_number, of)):
        raise UniconError(f"{kind} is {of!r:.60}; write {KINDS[kind]}")
    a, b = float(of[0]), float(of[1])
    low, high = a, b
    at: Callable[[float], float] = _short

    def refuse(why: str) -> None:
        raise UniconError(f"{kind} is {of!r}; {why}")

    if kind == "normal":
        if not b > 0.0:
            refuse("its standard deviation must be above 0")
        normal = NormalDist(a, b)
        low, high = normal.cdf(a - CUT * b), normal.cdf(a + CUT * b)
        at = lambda x: _short(normal.inv_cdf(x))  # noqa: E731
    elif not a <= b:
        refuse("the first number must not be above the second")
    elif kind == "range":
        if not all(isinstance(x, int) for x in of) or of[1] - of[0] >= MOST_VALUES:
            refuse(f"write two whole numbers, {MOST_VALUES} at most")
        return _listed(path, kind, list(range(of[0], of[1] + 1)), words)
    elif kind == "linspace":
        if not isinstance(of[2], int) or not 2 <= of[2] <= MOST_VALUES:
            refuse(f"write {KINDS[kind]}, N from 2 to {MOST_VALUES}")
        steps = of[2] - 1
        return _listed(path, kind, [_short(a + (b - a) * i / steps) for i in range(of[2])], words)
    elif kind == "log_uniform":
        if not a > 0.0:
            refuse("both numbers must be above 0")
        low, high = math.log(a), math.log(b)
        at = lambda x: min(max(_short(math.exp(x)), a), b)  # noqa: E731
    return Parameter(path, kind, lambda u: at(low + u * (high - low)), None, words)


KINDS = {
    "range": "{range: [FIRST, LAST]}",
    "linspace": "{linspace: [A, B, N]}",
    "uniform": "{uniform: [A, B]}",
    "log_uniform": "{log_uniform: [A, B]}",
    "normal": "{normal: [MEAN, STD]}",
}
_FORMS = ", ".join(KINDS.values())


def setting_of(path: str, value: Any) -> str:
    """Return `PATH=VALUE` as `--set` reads it, bit-exact.

    Raises:
        UniconError: it cannot be written so.
    """
    if type(value) in (int, float) and math.isfinite(value):  # 0.1 ms less
        text = repr(value)
        mantissa, exponent, power = text.partition("e")
        if exponent and "." not in mantissa:  # YAML takes 1e-05 for a word
            text = f"{mantissa}.0e{power}"
        return f"{path}={text}"
    text = _one_line(value)
    try:
        same = parse_value(text) == value
    except YamlError:
        same = False
    if not same:
        raise UniconError(f"value {value!r:.60} cannot be given to --set")
    return f"{path}={text}"


def _listed(path: str, kind: str, values: list[Any], words: str) -> Parameter:
    if not 1 <= len(values) <= MOST_VALUES:
        raise UniconError(f"has {len(values)} values; give 1 to {MOST_VALUES}")
    for value in values:
        setting_of(path, value)
        if isinstance(value, int) and not -(2**63) <= value < 2**63:
            raise UniconError(f"value {value} is more than 63 bits and a sign hold; give a smaller")
    each, count = tuple(values), len(values)
    return Parameter(path, kind, lambda u: each[min(int(u * count), count - 1)], each, words)


def _one_line(value: Any) -> str:
    text = yaml.safe_dump(value, default_flow_style=True, width=1_000_000)
    return str(text).strip().removesuffix("...").strip()


def _number(value: object) -> bool:
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    return math.isfinite(value)


def _short(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")
