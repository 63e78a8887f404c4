"""Gate of a sweep: a condition such as `fall<0.01`, for continuous integration."""

from __future__ import annotations

import operator
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from unicon_core.errors import UniconError, alternatives
from unicon_ros.sweep.figures import COLUMNS
from unicon_ros.sweep.proportions import wilson

if TYPE_CHECKING:
    from unicon_ros.sweep.results import Results

__all__ = ["Gate", "read_gate"]

_FORM = re.compile(r"\s*(\w+)(?:\.(\w+))?\s*(<=|>=|<|>)\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*")
_SIGNS = {"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge}
_SHARES = {"fall": "fell", "fault": "fault"}
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
    """

    text: str
    word: str
    statistic: str
    sign: str
    bar: float

    def value(self, results: Results) -> float:
        """Return what is compared; NaN where nothing can be."""
        if self.word in _SHARES:
            good = results.column(_SHARES[self.word])
            hits = sum(bool(value) for value in good)
            low, high = wilson(hits, len(good))
            rate = hits / len(good) if good else float("nan")
            return {"rate": rate, "lower": low, "upper": high}[self.statistic]
        values = np.array([v for v in results.column(self.word) if v is not None], np.float64)
        if not len(values):
            return float("nan")
        if self.statistic.startswith("p"):
            return float(np.percentile(values, int(self.statistic[1:])))
        return float(getattr(np, self.statistic)(values))

    def holds(self, results: Results) -> bool:
        """Return whether it holds; a rollout without a result breaks every gate."""
        complete = not results.lacking and not results.failed
        return complete and bool(_SIGNS[self.sign](self.value(results), self.bar))

    def told(self, results: Results) -> str:
        """Return the condition, what was found, and whether it holds."""
        verdict = "holds" if self.holds(results) else "BROKEN"
        return f"gate {self.text}: {self.value(results):.4g}, {verdict}"


def read_gate(text: str) -> Gate:
    """Return a condition.

    Args:
        text: such as `fall<0.01`, `fall.upper<0.02` (the upper end of its 95 % interval),
            `distance_m.p05>3`.

    Raises:
        UniconError: it is none.
    """
    found = _FORM.fullmatch(text)
    try:
        bar = float(found[4]) if found else 0.0
    except ValueError:
        found = None
    if found is None:
        raise UniconError(f"gate {text!r:.60} is no condition; write fall<0.01 or distance_m.p05>3")
    word, statistic, sign = found[1], found[2], found[3]
    figures = [name for name, column in COLUMNS.items() if column.kind in (int, float)]
    if word not in _SHARES and word not in figures:
        raise UniconError(
            f"gate {text!r}: no figure {word!r}; {alternatives(word, [*_SHARES, *figures])}"
        )
    known: Any = _OF_SHARES if word in _SHARES else _OF_FIGURES
    statistic = statistic or known[0]
    if statistic not in known:
        raise UniconError(
            f"gate {text!r}: {word} has no {statistic!r}; {alternatives(statistic, known)}"
        )
    return Gate(text.strip(), word, statistic, sign, bar)
