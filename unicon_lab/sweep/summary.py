"""Sweeps as text: what became of the rollouts, and whether a change made more of them fall."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from unicon_base.errors import UniconError, imported
from unicon_core.text_table import aligned
from unicon_lab.sweep.figures import COLUMNS, NUMBERS
from unicon_lab.sweep.results import Results, wilson

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


SURE = 0.05
NOT_COMPARED = ("ticks", "commanded_m", "duration_s", "fall_s")
DRAWN = ("vary", "sample", "points", "seed", "repeat")
"""Of an identity: where these are the same, so are the values of every row."""


def paired(a: Results, b: Results) -> bool:
    """Return whether row i of both had the same values of all parameters."""
    return all(a.identity.get(key) == b.identity.get(key) for key in DRAWN)


def comparison(a: Results, b: Results) -> str:
    """Return how two sweeps differ, as text.

    Rows with the same values are compared pair by pair: falls by McNemar's exact test, figures by
    Wilcoxon's signed ranks. Else falls by Fisher's exact test, figures by Mann-Whitney's U.

    Raises:
        UniconError: there is nothing to compare.
        MissingDependencyError: scipy is not installed.
    """
    stats = imported("scipy.stats", "unicon sweep compare", "sweep")
    for each in (a, b):
        if not each.good:
            raise UniconError(f"{each.path} has no rollout with a result; run it first")
    pairs = paired(a, b)
    places = _common(a, b) if pairs else (a.good, b.good)
    if not places[0]:
        raise UniconError(f"{a.path} and {b.path} have no row in common; run them further")

    def of(name: str) -> list[list[Any]]:
        return [[side.every(name)[i] for i in at] for side, at in zip((a, b), places)]

    fell = [list(map(bool, values)) for values in of("fell")]
    hits, counts = [sum(each) for each in fell], [len(each) for each in fell]
    if pairs:
        only_a = sum(x and not y for x, y in zip(*fell))
        differ = only_a + sum(y and not x for x, y in zip(*fell))
        p = stats.binomtest(only_a, differ).pvalue if differ else 1.0
    else:
        p = stats.fisher_exact([[hit, count - hit] for hit, count in zip(hits, counts)])[1]
    rows: list[tuple[str, ...]] = [("figure", "A", "B", "B - A", "p", "")]
    shares = [_share(hit, count) for hit, count in zip(hits, counts)]
    apart = hits[1] / counts[1] - hits[0] / counts[0]
    rows.append(("fell", *shares, f"{apart:+.2%}", f"{p:.2g}", _verdict(p)))
    for name in NUMBERS:
        if name in NOT_COMPARED:
            continue
        first, second = of(name)
        if pairs:
            both = [(x, y) for x, y in zip(first, second) if x is not None and y is not None]
            first, second = [x for x, _ in both], [y for _, y in both]
        x, y = (np.array([v for v in vs if v is not None], np.float64) for vs in (first, second))
        if len(x) and len(y):
            p = _p(stats, x, y, pairs)
            means = (x.mean(), y.mean())
            told = (*(f"{m:.4g}" for m in means), f"{means[1] - means[0]:+.3g}", f"{p:.2g}")
            rows.append((COLUMNS[name].named(name), *told, _verdict(p)))
    how = (
        f"{counts[0]} rows with the same values, pair by pair (McNemar, Wilcoxon)"
        if pairs
        else f"{counts[0]} and {counts[1]} rows (Fisher, Mann-Whitney)"
    )
    lines = [f"A {a.path}", f"B {b.path}", how, "", *aligned(rows, right=range(1, 5))]
    return "\n".join([*lines, *_changed(a, b)])


def _common(a: Results, b: Results) -> tuple[list[int], list[int]]:
    """Return the places of the rows that both have."""
    first = {a.rows[place]: place for place in a.good}
    second = {b.rows[place]: place for place in b.good}
    rows = sorted(first.keys() & second.keys())
    return [first[row] for row in rows], [second[row] for row in rows]


def _share(hits: int, count: int) -> str:
    low, high = wilson(hits, count)
    return f"{hits / count:.2%} ({low:.2%} – {high:.2%})"


def _p(stats: Any, x: Any, y: Any, pairs: bool) -> float:
    if pairs:
        return 1.0 if (x == y).all() else float(stats.wilcoxon(x, y).pvalue)
    return float(stats.mannwhitneyu(x, y).pvalue)


def _verdict(p: float) -> str:
    return "differs" if p < SURE else ""


def _changed(a: Results, b: Results) -> list[str]:
    """Return what the two were made of where that differs."""
    lines = []
    for key in (*a.identity, "code", "versions"):
        sides = [s.identity.get(key, s.said.get(key)) for s in (a, b)]
        if sides[0] != sides[1]:
            lines.append(f"{key} differs: {str(sides[0])[:160]} | {str(sides[1])[:160]}")
    made = [
        {f"{key} {value}" for each in side.said["programs"].values() for key, value in each.items()}
        for side in (a, b)
    ]
    lines += [f"only A has {word[:80]}" for word in sorted(made[0] - made[1])]
    lines += [f"only B has {word[:80]}" for word in sorted(made[1] - made[0])]
    return ["", *lines] if lines else []
