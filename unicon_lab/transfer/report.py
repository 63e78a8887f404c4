"""Report of a transfer: one page that needs nothing beside it, and PNGs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base import AnyMapping
from unicon_base.arrays import Array
from unicon_core.drawing import Pictures, curve, drawings, grid, zoomed
from unicon_core.page import findings, page, pairs, table, write_file
from unicon_lab.transfer.results import COLUMNS, FACTORS, OUTCOMES, cell, heads, row

_WORDS = {
    "runs": "how many of the runs that were asked for have come to an end",
    "falls": "runs in which the base leaned by more than 0.8 rad for 0.1 s, or 60° at all",
    "outcome": "the worst that became of a run",
}


def write_report(result: AnyMapping, folder: Path) -> Path:
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


def _said(result: AnyMapping) -> str:
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


def _legend(result: AnyMapping) -> str:
    words = {name: f"[{unit}] {what}" for name, unit, what in COLUMNS.values()} | _WORDS
    if len(result["seeds"]) > 1:
        words["±"] = "standard deviation over seeds (n − 1)"
    words["–"] = "there is no such figure"
    return pairs(words)


def _facts(result: AnyMapping) -> str:
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


def _engines(result: AnyMapping) -> str:
    """Return what each platform tells of itself, and what it cannot represent."""
    facts: dict[str, str] = {}
    for platform in result["platforms"]:
        run = next((run for run in platform["runs"] if run["outcome"] == "ran"), None)
        if run is None:
            continue
        versions = ", ".join(f"{name} {number}" for name, number in run["versions"].items())
        info = [(key, v) for key, v in run["info"].items() if isinstance(v, str | int | float)]
        told = "; ".join(f"{key} {value}" for key, value in info)
        notes = "".join(f"; {note}" for note in run["info"].get("notes", ()))
        facts[platform["platform"]] = f"{versions}; {told}{notes}"
    return "<h2>Engines</h2>" + pairs(facts) if facts else ""


Tracks = Mapping[str, Mapping[str, Array]]
"""Platform to name to states over time, of the first seed."""

TOP = 6
"""Joints whose curves are drawn."""
SMOOTH_S = 0.4
"""Over which speeds are averaged: longer than a step."""


def tracks_of(result: AnyMapping, folder: Path) -> dict[str, dict[str, Array]]:
    """Read the states of each platform's first run."""
    tracks = {}
    for platform in result["platforms"]:
        run = next((run for run in platform["runs"] if run["outcome"] == "ran"), None)
        if run is None or run["finite_rows"] < 2:
            continue
        with np.load(folder / run["file"]) as archive:
            count = run["finite_rows"]
            states = {
                name: archive[name]
                for name in ("joint_names", "joint_pos", "base_pos_w", "velocity_command")
            }
        named = states.pop("joint_names")
        tracks[platform["platform"]] = {n: rows[:count] for n, rows in states.items()} | {
            "joint_names": named
        }
    return tracks


def _figures(figure: Any, result: AnyMapping, tracks: Tracks) -> bool:
    shown = [p for p in result["platforms"] if p["runs_done"]]
    keys = [k for k in COLUMNS if any(p["figures"][k]["mean"] is not None for p in shown)]
    if not keys:
        return False
    every = grid(figure, len(keys), 4, 1.0 + 0.35 * len(shown), sharey=True)
    names = [p["platform"] for p in shown]
    for axes, key in zip(every, keys):
        heading, unit, _ = COLUMNS[key]
        factor = FACTORS.get(key, 1.0)
        for place, platform in enumerate(shown):
            told = platform["figures"][key]
            if told["mean"] is None:
                continue
            low_high = None if told["std"] is None else factor * told["std"]
            look = {"color": f"C{place % 10}", "alpha": 0.8, "capsize": 3, "ecolor": "0.5"}
            axes.barh(place, factor * told["mean"], xerr=low_high, **look)
        axes.set_title(f"{heading} [{unit}]")
        axes.set_yticks(range(len(names)), names)
        axes.locator_params(axis="x", nbins=5)
    every[0].invert_yaxis()
    return True


def _paths(figure: Any, result: AnyMapping, tracks: Tracks) -> bool:
    if not tracks:
        return False
    figure.set_size_inches(12.0, 5.0)
    left, right = figure.subplots(1, 2, width_ratios=[1.0, 1.4])
    period = result["period_s"]
    width = max(1, round(SMOOTH_S / period))
    longest = np.zeros((0, 3))
    for place, (name, states) in enumerate(tracks.items()):
        way, colour = states["base_pos_w"], f"C{place % 10}"
        left.plot(way[:, 0], way[:, 1], color=colour, linewidth=1.2, label=name)
        left.plot(way[-1:, 0], way[-1:, 1], "s", color=colour, markersize=5)
        if len(way) > 2 * width:
            moved = np.linalg.norm((way[width:] - way[:-width])[:, :2], axis=1)
            time = period * (np.arange(len(moved)) + width / 2)
            curve(right, time, moved / (width * period), colour)
        if len(states["velocity_command"]) > len(longest):
            longest = states["velocity_command"]
    asked = np.linalg.norm(longest[:, :2], axis=1)
    curve(right, period * np.arange(len(asked)), asked, "0.5", "commanded", linestyle="--")
    left.set(xlabel="x [m]", ylabel="y [m]")
    left.set_title("path of the base from above, its end as a square")
    left.set_aspect("equal", adjustable="datalim")
    right.set(xlabel="time [s]", ylabel="speed [m/s]")
    right.set_title(f"speed of the base in the plane, over {SMOOTH_S:g} s")
    left.legend()
    right.legend(loc="upper right")
    return True


def _joints(figure: Any, result: AnyMapping, tracks: Tracks) -> bool:
    first = result["first"]
    others = [name for name in tracks if name != first]
    if first not in tracks or not others:
        return False
    reference = tracks[first]["joint_pos"]
    squares = np.zeros(reference.shape)
    for name in others:
        count = min(len(reference), len(tracks[name]["joint_pos"]))
        squares[:count] += (reference[:count] - tracks[name]["joint_pos"][:count]) ** 2
    order = np.argsort(-squares.sum(axis=0))[:TOP]
    curves = [
        (name, f"C{place % 10}", states["joint_pos"][:, order])
        for place, (name, states) in enumerate(tracks.items())
    ]
    names = tracks[first]["joint_names"][order].tolist()
    zoomed(figure, names, curves, squares[:, order], result["period_s"])
    return True


PICTURES: Pictures = {
    "figures": (
        _figures,
        "Figures",
        "Mean of each platform; the whisker is the standard deviation over seeds, where there are "
        "several.",
    ),
    "paths": (_paths, "The base", "First run of each platform. Dashed: the commanded speed."),
    "joints": (
        _joints,
        "The joints that differ most",
        "Joint positions of the first run of each platform, not shifted in time; on the right the "
        "stretch that differs most (grey on the left).",
    ),
}
"""Name to function, heading and caption, in the report's order."""
