"""Report of a sweep: one page that needs nothing beside it, with maps of falls."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base import UniconError, imported
from unicon_base.arrays import Bool, Int64
from unicon_core.page import (
    Html,
    answers,
    findings,
    link,
    number,
    page,
    pairs,
    shell,
    table,
    write_file,
)
from unicon_core.text_table import aligned
from unicon_lab.sweep.figures import COLUMNS, NUMBERS
from unicon_lab.sweep.plan import STATES, row_name
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
        every = np.array(results.column(name), np.float64)  # None is NaN
        values = every[~np.isnan(every)]
        if not len(values) or name in LEFT_OUT:
            continue
        worst = (np.nanargmin if name in LOWEST_IS_WORST else np.nanargmax)(every)
        spread = values.std(ddof=1) if np.ptp(values) else 0.0  # not 3e-17 of equal ones
        figures = (values.mean(), spread if len(values) > 1 else np.nan)
        told = (*figures, *np.percentile(values, [5, 50, 95]))
        texts = [f"{x:.4g}" if np.isfinite(x) else "–" for x in told]
        rows.append((name, COLUMNS[name].unit, *texts, str(results.rows[results.good[worst]])))
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
    pairs = all(a.identity.get(key) == b.identity.get(key) for key in DRAWN)
    places = [a.good, b.good]
    if pairs:
        at = [{side.rows[place]: place for place in side.good} for side in (a, b)]
        places = [[side[row] for row in sorted(at[0].keys() & at[1].keys())] for side in at]
    if not places[0]:
        raise UniconError(f"{a.path} and {b.path} have no row in common; run them further")

    def of(name: str) -> list[list[Any]]:
        return [[side.every(name)[i] for i in at] for side, at in zip((a, b), places)]

    fell = [np.array(values, bool) for values in of("fell")]
    hits, counts = [int(each.sum()) for each in fell], [len(each) for each in fell]
    if pairs:
        only = [int((x & ~y).sum()) for x, y in (fell, fell[::-1])]
        p = stats.binomtest(only[0], sum(only)).pvalue if any(only) else 1.0
    else:
        p = stats.fisher_exact([[hit, count - hit] for hit, count in zip(hits, counts)])[1]
    rows = [("figure", "A", "B", "B - A", "p", "")]

    def row(name: str, apart: str, p: float, a: str, b: str) -> None:
        rows.append((name, a, b, apart, f"{p:.2g}", "differs" if p < SURE else ""))

    apart = f"{hits[1] / counts[1] - hits[0] / counts[0]:+.2%}"
    row("fell", apart, p, *map(_share, hits, counts))
    for name in (name for name in NUMBERS if name not in NOT_COMPARED):
        x, y = (np.array(values, np.float64) for values in of(name))  # None is NaN
        known = [~np.isnan(values) for values in (x, y)]
        if pairs:
            known = [known[0] & known[1]] * 2
        x, y = x[known[0]], y[known[1]]
        if len(x) and len(y):
            if pairs:
                p = 1.0 if (x == y).all() else float(stats.wilcoxon(x, y).pvalue)
            else:
                p = float(stats.mannwhitneyu(x, y).pvalue)
            apart = f"{y.mean() - x.mean():+.3g}"
            row(COLUMNS[name].named(name), apart, p, f"{x.mean():.4g}", f"{y.mean():.4g}")
    how = (
        f"{counts[0]} rows with the same values, pair by pair (McNemar, Wilcoxon)"
        if pairs
        else f"{counts[0]} and {counts[1]} rows (Fisher, Mann-Whitney)"
    )
    lines = [f"A {a.path}", f"B {b.path}", how, "", *aligned(rows, right=range(1, 5))]
    return "\n".join([*lines, *_changed(a, b)])


def _share(hits: int, count: int) -> str:
    low, high = wilson(hits, count)
    return f"{hits / count:.2%} ({low:.2%} – {high:.2%})"


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


WORST = 20
"""Rows that are shown with their commands."""


def write_report(results: Results) -> Path:
    """Write `report.html` into the folder of a sweep.

    Returns:
        The page.

    Raises:
        UniconError: it cannot be written.
    """
    parts = [
        _answers(results),
        _said(results),
        "<h2>Figures</h2>",
        table(HEADS, figure_rows(results)),
        *_falls(results),
        "<h2>Worst cases</h2>",
        '<p class="sub">Each command runs its row again, bit-exact: its report (--report FILE) '
        "has the same sha256_commands.</p>",
        _worst(results),
        "<h2>What the figures say</h2>",
        pairs({column.named(name): column.words for name, column in COLUMNS.items()}),
        "<h2>What was run</h2>",
        _facts(results),
    ]
    path = results.path / "report.html"
    title = f"{results.identity['workflow']}: {len(results)} rollouts"
    write_file(path, page(title, _varied(results), parts).encode())
    return path


def _answers(results: Results) -> str:
    """Return the answers: of all rows where they have one, else of the worst row."""
    place = next(iter(results.worst(1)), None)
    if place is None:
        return answers(*["no rollout has run yet"] * 6)
    row = results.row(place)
    name = f"row {row['row']}, the worst"
    hits = f"{row['position_limit_hits'] or 0} at a position, {row['effort_limit_hits'] or 0} at an"
    fault = (row["text"] or "no fault")[:120]
    joint = f"rows keep none; {name}: {hits} effort limit (ticks × joints); {fault}"
    end = f"ended at {number(row['duration_s'])} s: {row['outcome']}"
    when = f"{name}, fell at {row['fall_s']:.2f} s" if row["fell"] else f"{name}, {end}"

    def every(key: str) -> str:
        found = [(way or 0.0) / s for way, s in zip(*map(results.column, (key, "duration_s"))) if s]
        if not found:
            return "not known: no rollout has a tick"
        low, middle, high = np.percentile(found, [2.5, 50.0, 97.5])
        return f"{middle:.2f} m/s in the middle row (95 % of the rows: {low:.2f} to {high:.2f})"

    asked = f"{every('commanded_m')}; {name}: {', '.join(results.settings(place)) or 'as the file'}"
    return answers(
        joint, when, every("distance_m"), fall_words(results), asked, _recording(results, place)
    )


def _recording(results: Results, place: int) -> Html:
    """Return a link to the states of a row, where they are kept, and the command of the row."""
    path = results.path / STATES / f"{row_name(results.rows[place])}.npz"
    there = f"{link(path, results.path, path.name)} " if path.exists() else ""
    return Html(f"{there}{shell(results.command(place))}")


def _varied(results: Results) -> str:
    identity = results.identity
    said = "; ".join(f"{path}: {words}" for path, words in identity["vary"])
    repeated = f", {identity['repeat']} times each" if identity["repeat"] > 1 else ""
    return f"{identity['sample']} of {identity['points']} points{repeated}: {said}"


def _said(results: Results) -> str:
    said = [fall_words(results), f"Outcomes: {outcome_words(results) or 'none'}."]
    if results.lacking:
        said.append(f"{results.lacking} rollouts were not run yet.")
    if results.failed:
        said.append(f"{results.failed} rollouts have no result: they stand first below.")
    if results.mixed():
        said.append("Robot, model or policy were other files in some of the rows.")
    return findings(said, bad=bool(results.failed or results.mixed()))


def _worst(results: Results) -> str:
    figures = ("fall_s", "distance_m", "speed_error")
    heads = [f"{name}\n{COLUMNS[name].unit}" for name in figures]
    rows = []
    for place in results.worst(WORST):
        row = results.row(place)
        rows.append(
            [
                str(row["row"]),
                str(row["outcome"]),
                *(number(row[name]) for name in figures),
                str(row["fault_block"] or ""),
                str(row["text"] or "")[:120],
                _recording(results, place),
            ]
        )
    return table(["row", "outcome", *heads, "block", "said", "command"], rows, words=True)


def _facts(results: Results) -> str:
    said, identity = results.said, results.identity
    facts = {
        "workflow": f"{said.get('run')}, SHA-256 {identity['sha256_workflow']}",
        "the same in all": " ".join(identity["set"]) or "nothing",
        "duration": f"{identity['duration_s']:g} s at most"
        + (", ended at a fall" if identity["early_stop"] else ""),
        "sweep": f"SHA-256 {said['sha256']}",
        "table": f"SHA-256 {results.sha256}, of all rows",
        "code": f"SHA-256 {said.get('code')}",
        "versions": ", ".join(f"{name} {v}" for name, v in said.get("versions", {}).items()),
    }
    for name, made_of in said["programs"].items():
        facts[f"program {name}"] = ", ".join(f"{key} {value}" for key, value in made_of.items())
    return pairs(facts)


BINS, PAIR_BINS = 8, 6
"""Of a parameter with more values than that."""
MOST_VALUES = 16
"""That have a place each, of words."""
MOST_PAIRED = 6
"""Parameters of which every pair has a map: 15."""
ENOUGH = 10
"""Rollouts of a place in a map: of fewer the 95 % interval of a share is wider than 0.28."""


@dataclass(frozen=True)
class Bins:
    """Where the rows of a sweep fall, over one parameter.

    Attributes:
        path: of the parameter.
        labels: of the bins.
        places: bin of each row, shape (n,).
    """

    path: str
    labels: list[str]
    places: Int64

    def count(self, hits: Bool) -> list[tuple[int, int]]:
        """Return of each bin how many rows hit, and how many there are."""
        every = np.bincount(self.places, minlength=len(self.labels))
        some = np.bincount(self.places[hits], minlength=len(self.labels))
        return [(int(a), int(b)) for a, b in zip(some, every)]


def bins_of(path: str, values: Sequence[Any], most: int) -> Bins:
    """Return bins of a parameter: its values, or stretches with equally many rows.

    Args:
        path: of the parameter.
        values: of each row.
        most: bins; of words twice as many, then the rest together.
    """
    distinct = list(dict.fromkeys(values))
    numbers = all(isinstance(v, int | float) and not isinstance(v, bool) for v in distinct)
    if numbers and len(distinct) > most:
        array = np.array(values, np.float64)
        edges = np.unique(np.quantile(array, np.linspace(0.0, 1.0, most + 1)))
        places = np.clip(np.searchsorted(edges, array, side="right") - 1, 0, len(edges) - 2)
        labels = [f"{a:.3g} – {b:.3g}" for a, b in pairwise(edges)]
        return Bins(path, labels, places.astype(np.int64))
    ordered = sorted(distinct) if numbers else distinct
    shown, rest = ordered[:MOST_VALUES], ordered[MOST_VALUES:]
    at = {value: place for place, value in enumerate(shown)} | dict.fromkeys(rest, len(shown))
    labels = [f"{value:.4g}" if numbers else str(value)[-24:] for value in shown]
    labels += ["others"] if rest else []
    return Bins(path, labels, np.array([at[value] for value in values], np.int64))


def _falls(results: Results) -> Iterator[str]:
    """Yield how many fell over each parameter, but for the seed, which has no order; and over two.

    All other parameters vary as well.
    """
    hits = np.array(results.column("fell"), np.bool_)
    paths = [path for path in results.parameters if path != "scene.seed" and len(hits)]
    if not paths:
        return
    rows = [
        [bins.path, label, f"{some} of {count}", _share(some, count)]
        for bins in (bins_of(path, results.varied(path), BINS) for path in paths)
        for label, (some, count) in zip(bins.labels, bins.count(hits))
        if count
    ]
    yield "<h2>Falls over each parameter</h2>"
    yield table(["parameter", "value", "fell", "share (95 %)"], rows, words=True)
    most = max(2, min(PAIR_BINS, math.isqrt(len(hits) // ENOUGH)))
    every = [bins_of(path, results.varied(path), most) for path in paths[:MOST_PAIRED]]
    yield (
        "<h2>Falls over two parameters</h2>"
        f'<p class="sub">Fallen of all; a place has a colour from {ENOUGH} rollouts on, two '
        "parameters a map where their places have as many on average.</p>"
    )
    for across, up in combinations(every, 2):
        wide = len(across.labels)
        if len(hits) >= ENOUGH * wide * len(up.labels):
            both = Bins("", [""] * (wide * len(up.labels)), up.places * wide + across.places)
            cells = [*map(_cell, both.count(hits))]
            rows = [[label, *cells[k * wide :][:wide]] for k, label in enumerate(up.labels)]
            yield table([f"{up.path}\n{across.path} →", *across.labels], rows)


def _cell(counts: tuple[int, int]) -> str:
    some, count = counts
    look = f"background: color-mix(in srgb, var(--hot) {60 * some // max(count, 1)}%, transparent)"
    text = f"{some}/{count}"
    return text if count < ENOUGH else Html(f'<span style="{look}">{text}</span>')
