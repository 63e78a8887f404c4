"""Report of a transfer: one page that needs nothing beside it, and PNGs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from unicon_base import AnyMapping
from unicon_base.arrays import Array
from unicon_core.drawing import COLOURS, INK, Curve, Lines, Panel, Pictures, drawings, worst
from unicon_core.page import Html, answers, findings, link, page, pairs, table, write_file
from unicon_lab.report import ANSWERING, words
from unicon_lab.sweep.results import wilson
from unicon_lab.transfer.results import BESIDE, COLUMNS, OUTCOMES, cell, heads, row


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
        _answers(result, tracks),
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


def _answers(result: AnyMapping, tracks: Tracks) -> str:
    order, squares = most_apart(result, tracks)
    joint, when = "none: there are no two runs to compare", "at no time"
    if len(order):
        k, period = order[0], result["period_s"]
        names, off = tracks[result["first"]]["joint_names"], squares[:, k].mean() ** 0.5
        joint = f"{names[k]} differs most from {result['first']}, by {off:.2g} rad RMS"
        begin, end = worst(squares[:, k], period)
        when = f"most from {begin:.2f} to {end:.2f} s of the first runs"
    said = {name: words(states, result["period_s"]) for name, states in tracks.items()}
    fast = "; ".join(f"{name} {each[0]}" for name, each in said.items()) or "no run"
    asked = "; ".join(dict.fromkeys(each[2] for each in said.values())) or "no run"
    fell = "; ".join(
        f"{p['platform']} {p['falls']} of {p['runs_done']} (95 %: {low:.0%} to {high:.0%})"
        for p in result["platforms"]
        for low, high in [wilson(p["falls"], p["runs_done"])]
    )
    files = [link(run["file"], "") for p in result["platforms"] if (run := _first_run(p))]
    return answers(joint, when, fast, fell, asked, Html(", ".join(files) or "no run"))


def _first_run(platform: AnyMapping) -> AnyMapping | None:
    """Return a platform's first run that came to its end, if any."""
    return next((run for run in platform["runs"] if run["outcome"] == "ran"), None)


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
    words = {name: f"[{unit}] {what}" for name, unit, what in COLUMNS.values()} | BESIDE
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
        run = _first_run(platform)
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
        run = _first_run(platform)
        if run is None or run["finite_rows"] < 2:
            continue
        with np.load(folder / run["file"]) as archive:
            count = run["finite_rows"]
            states = {
                name: archive[name]
                for name in ("joint_names", "joint_pos", "base_pos_w", *ANSWERING)
                if name in archive
            }
        named = states.pop("joint_names")
        tracks[platform["platform"]] = {n: rows[:count] for n, rows in states.items()} | {
            "joint_names": named
        }
    return tracks


def _curves(result: AnyMapping, tracks: Mapping[str, Array], first: float = 0.0) -> list[Curve]:
    """Return a curve for each platform; the seventh on are dashed."""
    return [
        Curve(
            name,
            COLOURS[k % 6],
            result["period_s"] * (first + np.arange(len(v))),
            v,
            k // 6 * (6, 3),
        )
        for k, (name, v) in enumerate(tracks.items())
    ]


def _speeds(result: AnyMapping, tracks: Tracks) -> Iterator[Panel]:
    width, speeds = max(1, round(SMOOTH_S / (result["period_s"] or 1.0))), dict[str, Array]()
    for name, states in tracks.items():
        moved = (states["base_pos_w"][width:] - states["base_pos_w"][:-width])[:, :2]
        speeds[name] = np.linalg.norm(moved, axis=1) / (width * result["period_s"])
    asked = max((each["velocity_command"] for each in tracks.values()), key=len, default=None)
    if asked is not None:
        way = np.linalg.norm(asked[:, :2], axis=1)
        time = result["period_s"] * np.arange(len(way))
        commanded = Curve("commanded", INK, time, way, (2, 3))
        curves = [*_curves(result, speeds, width / 2), commanded]
        yield Panel(f"speed of the base in the plane, over {SMOOTH_S:g} s", "m/s", curves)


def most_apart(result: AnyMapping, tracks: Tracks) -> tuple[list[int], Array]:
    """Return the joints from the one that differs most on, and the squares of the differences.

    Returns:
        Columns of the joints of the first platform, none where there is nothing to compare; squares
        in [rad²], summed over the other platforms, shape (ticks, joints).
    """
    first = tracks.get(result["first"])
    if first is None or len(tracks) < 2:
        return [], np.zeros((0, 0))
    squares = np.zeros(first["joint_pos"].shape)
    for states in tracks.values():
        count = min(len(squares), len(states["joint_pos"]))
        squares[:count] += (first["joint_pos"][:count] - states["joint_pos"][:count]) ** 2
    return np.argsort(-squares.sum(axis=0)).tolist(), squares


def _joints(result: AnyMapping, tracks: Tracks) -> Iterator[Panel]:
    order, squares = most_apart(result, tracks)
    for k in order[:TOP]:
        name = str(tracks[result["first"]]["joint_names"][k])
        curves = _curves(result, {n: states["joint_pos"][:, k] for n, states in tracks.items()})
        yield Panel(name, "rad", curves, [worst(squares[:, k], result["period_s"])])


PICTURES: Pictures = {
    "speeds": (Lines(_speeds), "Speed", "First run of each platform. Dotted: the commanded speed."),
    "joints": (
        Lines(_joints),
        "The joints that differ most",
        "Joint positions of the first run of each platform, not shifted in time; grey is where a "
        "joint differs most.",
    ),
}
"""Name to function, heading and caption, in the report's order."""
