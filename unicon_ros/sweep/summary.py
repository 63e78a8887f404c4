"""Summary of a sweep as text: what became of the rollouts, and their figures."""

from __future__ import annotations

from collections import Counter

import numpy as np

from unicon_core.aligned import aligned
from unicon_ros.sweep.figures import COLUMNS, NUMBERS
from unicon_ros.sweep.proportions import wilson
from unicon_ros.sweep.results import Results

HEADS = ("figure", "unit", "mean", "std", "p05", "p50", "p95", "worst row")
LOWEST_IS_WORST = ("distance_m", "duration_s", "fall_s")
LEFT_OUT = ("ticks", "commanded_m")


def fall_words(results: Results) -> str:
    """Return how many fell, with Wilson's interval; of a fixed base, that none is known."""
    column = results.column("fell")
    fell = [value for value in column if value is not None]
    if column and not fell:
        return "no fall is known: the base is fixed, or no rollout had a tick"
    hits, count = sum(bool(value) for value in fell), len(fell)
    low, high = wilson(hits, count)
    return f"{hits} of {count} fell: {hits / max(count, 1):.2%} (95 %: {low:.2%} to {high:.2%})"


def outcome_words(results: Results) -> str:
    """Return how many rollouts ended in which way."""
    counts = Counter(results.every("outcome"))
    return ", ".join(f"{count} {word}" for word, count in counts.most_common())


def figure_rows(results: Results) -> list[tuple[str, ...]]:
    """Return a row for each figure that there is, with the columns of `HEADS`."""
    rows = []
    for name in NUMBERS:
        pairs = [
            (value, results.every("row")[place])
            for place, value in zip(results.good, results.column(name))
            if value is not None
        ]
        if not pairs or name in LEFT_OUT:
            continue
        values = np.array([value for value, _ in pairs], np.float64)
        worst = np.argmin(values) if name in LOWEST_IS_WORST else np.argmax(values)
        low, middle, high = np.percentile(values, [5, 50, 95])
        spread = values.std(ddof=1) if np.ptp(values) else 0.0  # not 3e-17 of equal ones
        figures = (values.mean(), spread if len(values) > 1 else np.nan)
        told = [f"{x:.4g}" if np.isfinite(x) else "–" for x in (*figures, low, middle, high)]
        rows.append((name, COLUMNS[name].unit, *told, str(pairs[int(worst)][1])))
    return rows


def summary(results: Results) -> str:
    """Return all that a terminal is told of a sweep."""
    lines = [
        f"{results.identity['workflow']}: {len(results)} of {results.asked} rollouts "
        f"({outcome_words(results) or 'none'})",
        fall_words(results),
        "",
        *aligned([HEADS, *figure_rows(results)], right=range(2, len(HEADS))),
        "",
        f"table  SHA-256 {results.sha256}",
    ]
    if results.mixed():
        lines.append("warning: robot, model or policy were other files in some of the rows")
    return "\n".join(lines)
