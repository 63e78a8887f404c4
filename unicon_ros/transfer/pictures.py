"""Pictures of a transfer, for its page and beside it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_ros.report.drawing import envelope, grids
from unicon_ros.transfer.table import COLUMNS, FACTORS

Tracks = Mapping[str, Mapping[str, NDArray[Any]]]
"""Platform to name to states over time, of the first seed."""

TOP = 6
"""Joints whose curves are drawn."""
ZOOM_S = 2.0
SMOOTH_S = 0.4
"""Over which speeds are averaged: longer than a step."""


def tracks_of(result: Mapping[str, Any], folder: Path) -> dict[str, dict[str, NDArray[Any]]]:
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


def _figures(figure: Any, result: Mapping[str, Any], tracks: Tracks) -> bool:
    shown = [p for p in result["platforms"] if p["runs_done"]]
    keys = [k for k in COLUMNS if any(p["figures"][k]["mean"] is not None for p in shown)]
    if not keys:
        return False
    columns = 4
    lines = -(-len(keys) // columns)
    figure.set_size_inches(12.0, lines * (1.0 + 0.35 * len(shown)))
    grid = figure.subplots(lines, columns, squeeze=False, sharey=True).reshape(-1)
    for axes in grid[len(keys) :]:
        axes.set_axis_off()
    names = [p["platform"] for p in shown]
    for axes, key in zip(grid, keys):
        heading, unit, _ = COLUMNS[key]
        factor = FACTORS.get(key, 1.0)
        for place, platform in enumerate(shown):
            told = platform["figures"][key]
            if told["mean"] is None:
                continue
            axes.barh(
                place,
                factor * told["mean"],
                xerr=None if told["std"] is None else factor * told["std"],
                color=f"C{place % 10}",
                alpha=0.8,
                capsize=3,
                ecolor="0.5",
            )
        axes.set_title(f"{heading} [{unit}]", fontsize=9)
        axes.set_yticks(range(len(names)), names, fontsize=8)
        axes.tick_params(labelsize=8)
        axes.locator_params(axis="x", nbins=5)
        axes.grid(axis="x", alpha=0.3)
    grid[0].invert_yaxis()
    return True


def _paths(figure: Any, result: Mapping[str, Any], tracks: Tracks) -> bool:
    if not tracks:
        return False
    figure.set_size_inches(12.0, 5.0)
    left, right = figure.subplots(1, 2, width_ratios=[1.0, 1.4])
    period = result["period_s"]
    width = max(1, round(SMOOTH_S / period))
    longest: NDArray[Any] = np.zeros((0, 3))
    for place, (name, states) in enumerate(tracks.items()):
        way, colour = states["base_pos_w"], f"C{place % 10}"
        left.plot(way[:, 0], way[:, 1], color=colour, linewidth=1.2, label=name)
        left.plot(way[-1:, 0], way[-1:, 1], "s", color=colour, markersize=5)
        if len(way) > 2 * width:
            moved = np.linalg.norm((way[width:] - way[:-width])[:, :2], axis=1)
            time = period * (np.arange(len(moved)) + width / 2)
            right.plot(*envelope(time, moved / (width * period)), color=colour, linewidth=1.0)
        if len(states["velocity_command"]) > len(longest):
            longest = states["velocity_command"]
    asked = np.linalg.norm(longest[:, :2], axis=1)
    right.plot(
        period * np.arange(len(asked)), asked, "--", color="0.5", linewidth=1.3, label="commanded"
    )
    left.set(xlabel="x [m]", ylabel="y [m]")
    left.set_title("path of the base from above, its end as a square", fontsize=10)
    left.set_aspect("equal", adjustable="datalim")
    right.set(xlabel="time [s]", ylabel="speed [m/s]")
    right.set_title(f"speed of the base in the plane, over {SMOOTH_S:g} s", fontsize=10)
    left.legend(fontsize=8)
    right.legend(fontsize=8, loc="upper right")
    grids(left, right)
    return True


def _joints(figure: Any, result: Mapping[str, Any], tracks: Tracks) -> bool:
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
    period = result["period_s"]
    count = min(len(reference), max(2, round(ZOOM_S / period)))
    figure.set_size_inches(12.0, 0.8 + 1.7 * len(order))
    rows = figure.subplots(len(order), 2, squeeze=False, width_ratios=[2.0, 1.0])
    for (left, right), k in zip(rows, order):
        sums = np.concatenate([[0.0], np.cumsum(squares[:, k])])
        worst = int(np.argmax(sums[count:] - sums[:-count]))
        for axes, part in ((left, slice(None)), (right, slice(worst, worst + count))):
            for place, (name, states) in enumerate(tracks.items()):
                curve = states["joint_pos"][part, k]
                time = period * ((part.start or 0) + np.arange(len(curve)))
                if len(curve):
                    axes.plot(
                        *envelope(time, curve), color=f"C{place % 10}", linewidth=1.0, label=name
                    )
        left.axvspan(worst * period, (worst + count) * period, color="0.5", alpha=0.2)
        left.set_title(str(tracks[first]["joint_names"][k]), fontsize=10, loc="left")
        left.set_ylabel("[rad]")
        grids(left, right)
    rows[0][0].legend(loc="upper right", fontsize=8, ncols=len(tracks))
    rows[0][1].set_title(f"the {count * period:.3g} s that differ most", fontsize=10)
    for axes in rows[-1]:
        axes.set_xlabel("time [s]")
    return True


PICTURES: dict[str, tuple[Callable[[Any, Mapping[str, Any], Tracks], bool], str, str]] = {
    "figures": (
        _figures,
        "Figures",
        "Mean of each platform; the whisker is the standard deviation over seeds, where there are "
        "several.",
    ),
    "paths": (
        _paths,
        "The base",
        "First run of each platform. Dashed: the commanded speed.",
    ),
    "joints": (
        _joints,
        "The joints that differ most",
        "Joint positions of the first run of each platform, not shifted in time; on the right the "
        "stretch that differs most (grey on the left).",
    ),
}
"""Name to function, heading and caption, in the report's order."""
