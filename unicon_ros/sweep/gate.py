"""Gate of a sweep: a condition such as `fall<0.01`, for continuous integration."""

from __future__ import annotations

import operator
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from unicon_core.errors import UniconError, alternatives
from unicon_ros.sweep.figures import COLUMNS
from unicon_ros.sweep.proportions import wilson

if TYPE_CHECKING:
    from unicon_ros.sweep.results import Results

__all__ = ["Gate", "read_gate"]

_EACH = " for each "
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

    def values(self, results: Results) -> list[tuple[Any, float]]:
        """Return each value of the parameter, or None, and what is compared there; worst first.

        Raises:
            UniconError: the parameter was not varied.
        """
        places: dict[str, list[int]] = {"": list(range(len(results.good)))}
        shown: dict[str, Any] = {"": None}
        if self.each:
            self.check(results.parameters)
            places, shown = {}, {}
            for place, value in enumerate(results.varied(self.each)):
                places.setdefault(repr(value), []).append(place)
                shown[repr(value)] = value
        found = [(shown[key], self._of(results, rows)) for key, rows in places.items()]
        upwards = self.sign.startswith(">")
        return sorted(found, key=lambda x: (x[1] == x[1], x[1] if upwards else -x[1]))

    def _of(self, results: Results, places: list[int]) -> float:
        """What is compared of some rows with a result; NaN where nothing can be."""
        column = results.column(_SHARES.get(self.word, self.word))
        there = [column[place] for place in places]
        if self.word in _SHARES:
            good = [value for value in there if value is not None]
            if not good:
                return float("nan")
            hits = sum(map(bool, good))
            low, high = wilson(hits, len(good))
            return {"rate": hits / len(good), "lower": low, "upper": high}[self.statistic]
        values = np.array([v for v in there if v is not None], np.float64)
        if not len(values):
            return float("nan")
        if self.statistic.startswith("p"):
            return float(np.percentile(values, int(self.statistic[1:])))
        return float(getattr(np, self.statistic)(values))

    def holds(self, results: Results) -> bool:
        """Return whether it holds; a rollout without a result breaks every gate."""
        complete = not results.lacking and not results.failed
        found = self.values(results)
        return complete and bool(found) and all(_SIGNS[self.sign](v, self.bar) for _, v in found)

    def told(self, results: Results) -> str:
        """Return the condition, what was found where it is worst, and whether it holds."""
        if results.lacking:
            return f"gate {self.text}: not known yet"
        verdict = "holds" if self.holds(results) else "BROKEN"
        where, value = next(iter(self.values(results)), (None, float("nan")))
        at = f" at {where}" if self.each else ""
        return f"gate {self.text}: {value:.4g}{at}, {verdict}"


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
    return Gate(text.strip(), word, statistic, sign, bar, each.strip())
