"""Report of a sweep: one page that needs nothing beside it."""

from __future__ import annotations

from pathlib import Path

from unicon_core.page import findings, number, page, pairs, table, write_file
from unicon_ros.report.drawing import drawings, require
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
