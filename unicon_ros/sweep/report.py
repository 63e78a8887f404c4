"""Report of a sweep: one page that needs nothing beside it."""

from __future__ import annotations

import html
from pathlib import Path
from typing import Any

from unicon_core.page import figure, findings, number, page, pairs, table, units, write_file
from unicon_ros.report.drawing import as_svg, drawn, require
from unicon_ros.sweep.figures import COLUMNS
from unicon_ros.sweep.pictures import PICTURES
from unicon_ros.sweep.results import Results
from unicon_ros.sweep.summary import HEADS, fall_words, figure_rows, outcome_words

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
    figures = []
    for name, (fill, heading, caption) in PICTURES.items():
        picture = drawn(fill, results)
        if picture is not None:
            figures.append(figure(heading, caption, as_svg(picture, name)))
    title = f"{results.identity['workflow']}: {len(results)} rollouts"
    parts = [
        f"<h1>{html.escape(title)}</h1>",
        f'<p class="sub">{html.escape(_varied(results))}</p>',
        _said(results),
        "<h2>Figures</h2>",
        table([html.escape(head) for head in HEADS], figure_rows(results)),
        *figures,
        "<h2>Worst cases</h2>",
        '<p class="sub">Each command runs its row again, to the bit: its report (--report FILE) '
        "has the same sha256_commands.</p>",
        _worst(results),
        "<h2>What the figures say</h2>",
        pairs({f"{n} [{c.unit}]" if c.unit else n: c.words for n, c in COLUMNS.items()}),
        "<h2>What was run</h2>",
        _facts(results),
    ]
    path = results.path / "report.html"
    write_file(path, page(title, parts).encode())
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
    heads = ("row", "outcome", "fall_s", "distance_m", "speed_error", "block", "said", "command")
    below = ["", "", "s", "m", "m/s", "", "", ""]
    rows = []
    for place in results.worst(WORST):
        row = results.row(place)
        rows.append(
            [
                str(row["row"]),
                str(row["outcome"]),
                *(_number(row[name]) for name in ("fall_s", "distance_m", "speed_error")),
                str(row["fault_block"] or ""),
                str(row["text"] or "")[:120],
                results.command(place),
            ]
        )
    return table(units(heads, below), rows, words=True)


def _number(value: Any) -> str:
    return "–" if value is None else number(float(value))


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
