"""Report of a transfer: one page that needs nothing beside it, and PNGs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from unicon_core.page import findings, page, pairs, table, write_file
from unicon_ros.report.drawing import drawings
from unicon_ros.transfer.pictures import PICTURES, tracks_of
from unicon_ros.transfer.results import OUTCOMES
from unicon_ros.transfer.table import COLUMNS, cell, heads, row

_WORDS = {
    "runs": "how many of the runs that were asked for have come to an end",
    "falls": "runs in which the base leaned by more than 0.8 rad for 0.1 s, or 60° at all",
    "outcome": "the worst that became of a run",
}


def write_report(result: Mapping[str, Any], folder: Path) -> Path:
    """Write `report.html`, and a PNG for each picture.

    Args:
        result: as the JSON has it.
        folder: of the transfer.

    Returns:
        The page.

    Raises:
        UniconError: a file cannot be written.
    """
    tracks = tracks_of(result, folder)
    parts = [
        _said(result),
        "<h2>Comparison</h2>",
        table(heads("\n{}"), [row(each) for each in result["platforms"]]),
        _legend(result),
        *(shown for _, shown in drawings(PICTURES, result, tracks, folder=folder)),
        "<h2>What was run</h2>",
        _facts(result),
        _engines(result),
        '<p class="sub">All figures of all runs, with all digits: transfer.json; the states of '
        "every tick: runs/PLATFORM/seed_K.npz, which unicon analyze reads. unicon_ros "
        f"{result['unicon_ros']}</p>",
    ]
    path, workflow = folder / "report.html", result["workflow"]
    title = f"{workflow['name']} in {len(result['platforms'])} simulators"
    write_file(path, page(title, workflow["description"], parts).encode())
    return path


def _said(result: Mapping[str, Any]) -> str:
    """Return what stands out, in a box."""
    said = [
        f"{len(result['platforms'])} platforms, {len(result['seeds'])} "
        f"{'seed' if len(result['seeds']) == 1 else 'seeds'} each; the joints of the others are "
        f"compared with those of {result['first']}."
    ]
    for each in result["platforms"]:
        share = each["figures"]["distance_share"]
        falls = f"{each['falls']} of {each['runs_done']} fell" if each["falls"] else "no fall"
        if each["runs_done"]:
            way = f"{cell(share, 100.0)} % of the commanded way, " if share["runs"] else ""
            said.append(f"{each['platform']}: {way}{falls}.")
        else:
            said.append(f"{each['platform']}: {OUTCOMES[each['outcome']]}.")
        said += [f"{each['platform']}: {text}" for text in each["troubles"]]
    said += result["notes"]
    if result["interrupted"]:
        said.append("It was interrupted: what was done until then is shown.")
    return findings(said)


def _legend(result: Mapping[str, Any]) -> str:
    words = {name: f"[{unit}] {what}" for name, unit, what in COLUMNS.values()} | _WORDS
    if len(result["seeds"]) > 1:
        words["±"] = "standard deviation over seeds (n − 1)"
    words["–"] = "there is no such figure"
    return pairs(words)


def _facts(result: Mapping[str, Any]) -> str:
    workflow = result["workflow"]
    facts = {
        "workflow": f"{workflow['file']}, SHA-256 {workflow['sha256']}",
        "changed by --set": ", ".join(workflow["overrides"]) or "nothing",
        "robot": result["robot"] or "–",
        **{f"policy {name}": f"SHA-256 {sha}" for name, sha in result["policies"].items()},
        "commanded way": f"{result['commanded_m']:.3g} m",
        "longest run": f"{result['duration_s']:g} s",
        "seeds": ", ".join(map(str, result["seeds"])),
        "machine": result["machine"],
    }
    return pairs(facts)


def _engines(result: Mapping[str, Any]) -> str:
    """Return what each platform tells of itself, and what it cannot represent."""
    facts: dict[str, str] = {}
    for platform in result["platforms"]:
        run = next((run for run in platform["runs"] if run["outcome"] == "ran"), None)
        if run is None:
            continue
        versions = ", ".join(f"{name} {number}" for name, number in run["versions"].items())
        info = [(key, v) for key, v in run["info"].items() if isinstance(v, (str, int, float))]
        told = "; ".join(f"{key} {value}" for key, value in info)
        notes = "".join(f"; {note}" for note in run["info"].get("notes", ()))
        facts[platform["platform"]] = f"{versions}; {told}{notes}"
    return "<h2>Engines</h2>" + pairs(facts) if facts else ""
