"""Gate of a sweep: a condition such as `fall<0.01`, for continuous integration."""

from __future__ import annotations

import operator
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from unicon_core.errors import UniconError, alternatives
from unicon_ros.sweep.figures import NUMBERS

_EACH = " for each "
_FORM = re.compile(r"\s*(\w+)(?:\.(\w+))?\s*(<=|>=|<|>)\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*")
_SIGNS = {"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge}
SHARES = {"fall": "fell", "fault": "fault"}
"""Word to the column whose share of rollouts it is."""
_OF_SHARES = ("rate", "lower", "upper")
_OF_FIGURES = ("mean", "min", "max", "p05", "p50", "p95")


@dataclass(frozen=True)
class Gate:
    """A condition.

    Attributes:
        text: as it was written.
        word: `fall`, `fault`, or a figure.
        statistic: of it over all rollouts.
        sign: how it is compared.
        bar: with what.
        each: parameter for whose values it has to hold one by one; "" for all rollouts together.
    """

    text: str
    word: str
    statistic: str
    sign: str
    bar: float
    each: str = ""

    def check(self, parameters: Sequence[str]) -> None:
        """Look whether what it is asked for each value of is varied.

        Raises:
            UniconError: it is not.
        """
        if self.each and self.each not in parameters:
            raise UniconError(
                f"gate {self.text!r}: {self.each!r} is not varied; "
                f"{alternatives(self.each, parameters)}"
            )

    def met(self, value: float) -> bool:
        """Return whether a value holds the condition; NaN never does."""
        return bool(_SIGNS[self.sign](value, self.bar))


def read_gate(text: str) -> Gate:
    """Return a condition.

    Args:
        text: such as `fall<0.01`, `fall.upper<0.02` (the upper end of its 95 % interval),
            `distance_m.p05>3`, `speed_bias<0.1 for each scene.payload.mass`.

    Raises:
        UniconError: it is none.
    """
    condition, _, each = text.partition(_EACH)
    found = _FORM.fullmatch(condition)
    try:
        bar = float(found[4]) if found else 0.0
    except ValueError:
        found = None
    if found is None:
        raise UniconError(
            f"gate {text!r:.60} is not a condition; write fall<0.01 or distance_m.p05>3"
        )
    word, statistic, sign = found[1], found[2], found[3]
    if word not in SHARES and word not in NUMBERS:
        raise UniconError(
            f"gate {text!r}: no figure {word!r}; {alternatives(word, [*SHARES, *NUMBERS])}"
        )
    known: Any = _OF_SHARES if word in SHARES else _OF_FIGURES
    statistic = statistic or known[0]
    if statistic not in known:
        raise UniconError(
            f"gate {text!r}: {word} has no {statistic!r}; {alternatives(statistic, known)}"
        )
    return Gate(text.strip(), word, statistic, sign, bar, each.strip())
