"""Report of a sweep: one page that needs nothing beside it, with pictures of falls."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base import UniconError, imported
from unicon_base.arrays import Bool, Int64
from unicon_core.drawing import MARK, Pictures, drawings, grid, require
from unicon_core.page import findings, number, page, pairs, table, write_file
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

    def row(name: str, a: str, b: str, apart: str, p: float) -> None:
        rows.append((name, a, b, apart, f"{p:.2g}", "differs" if p < SURE else ""))

    apart = hits[1] / counts[1] - hits[0] / counts[0]
    a_share, b_share = map(_share, hits, counts)
    row("fell", a_share, b_share, f"{apart:+.2%}", p)
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
            a_mean, b_mean = x.mean(), y.mean()
            apart_text = f"{b_mean - a_mean:+.3g}"
            row(COLUMNS[name].named(name), f"{a_mean:.4g}", f"{b_mean:.4g}", apart_text, p)
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
        MissingDependencyError: matplotlib is not installed.
        UniconError: it cannot be written.
    """
    require("unicon sweep report")
    parts = [
        _said(results),
        "<h2>Figures</h2>",
        table(HEADS, figure_rows(results)),
        *(shown for _, shown in drawings(PICTURES, results)),
        "<h2>Worst cases</h2>",
        '<p class="sub">Each command runs its row again, to the bit: its report (--report FILE) '
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
                results.command(place),
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
"""Parameters of which every pair is drawn: 15 maps."""
ACROSS = 3


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
    labels = [f"{value:.4g}" if numbers else _shown(str(value)[-24:]) for value in shown]
    labels += ["others"] if rest else []
    return Bins(path, labels, np.array([at[value] for value in values], np.int64))


def _shown(text: str) -> str:
    """Return a text as matplotlib draws it to the letter: between two $ it would read formulas."""
    return text.replace("$", r"\$")


def _binned(results: Results, most: int) -> tuple[list[Bins], Bool]:
    """Return the bins of each parameter, but of the seed: it has no order; and who fell."""
    paths = [path for path in results.parameters if path != "scene.seed" and results.good]
    bins = [bins_of(_shown(path), results.varied(path), most) for path in paths]
    return bins, np.array(results.column("fell"), np.bool_)


def _each(figure: Any, results: Results) -> bool:
    shown, hits = _binned(results, BINS)
    if not shown:
        return False
    every = grid(figure, len(shown), ACROSS, 3.1, sharey=True)
    for axes, bins in zip(every, shown):
        places = np.arange(len(bins.labels))
        counts = bins.count(hits)
        rates = np.array([some / count if count else np.nan for some, count in counts])
        ends = np.array([wilson(*each) for each in counts])
        axes.vlines(places, ends[:, 0], ends[:, 1], color=MARK, linewidth=2.0, alpha=0.5)
        axes.plot(places, rates, "o", color=MARK)
        axes.set_xticks(places, bins.labels, rotation=35, ha="right", fontsize=7)
        axes.set_title(bins.path)
        axes.set_ylim(-0.03, 1.03)
    for axes in every[::ACROSS]:
        axes.set_ylabel("share that fell")
    return True


def _pairs(figure: Any, results: Results) -> bool:
    shown, hits = _binned(results, PAIR_BINS)
    pairs = list(combinations(shown[:MOST_PAIRED], 2))
    if not pairs:
        return False
    for axes, (across, up) in zip(grid(figure, len(pairs), ACROSS, 3.6), pairs):
        shape = (len(up.labels), len(across.labels))
        every, some = np.zeros(shape, np.int64), np.zeros(shape, np.int64)
        np.add.at(every, (up.places, across.places), 1)
        np.add.at(some, (up.places[hits], across.places[hits]), 1)
        rates = np.where(every > 0, some / np.maximum(every, 1), np.nan)
        axes.imshow(rates, cmap="Reds", vmin=0.0, vmax=1.0, origin="lower", aspect="auto")
        for (i, k), count in np.ndenumerate(every):
            if count:
                ink = "white" if rates[i, k] > 0.6 else "black"
                text = f"{some[i, k]}/{count}"
                axes.text(k, i, text, ha="center", va="center", fontsize=6, color=ink)
        axes.set_xticks(range(shape[1]), across.labels, rotation=35, ha="right", fontsize=6)
        axes.set_yticks(range(shape[0]), up.labels, fontsize=6)
        axes.grid(False)
        axes.set(xlabel=across.path, ylabel=up.path)
    return True


PICTURES: Pictures = {
    "falls": (
        _each,
        "Falls over each parameter",
        "Share of rollouts that fell, with Wilson's 95 % interval; all others vary as well. "
        "Numbers are in stretches with equally many rollouts.",
    ),
    "pairs": (
        _pairs,
        "Falls over two parameters",
        "Share that fell, dark is more; in each place those that fell of those there are.",
    ),
}
"""Name to what draws it, heading and caption."""
