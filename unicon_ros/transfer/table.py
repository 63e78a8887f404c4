"""Table: a transfer's results in a terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from unicon_core.aligned import aligned
from unicon_ros.transfer.results import OUTCOMES

COLUMNS: dict[str, tuple[str, str, str]] = {
    "distance_m": ("distance", "m", "way in the commanded direction"),
    "distance_share": ("of commanded", "%", "the same as a share of what was commanded"),
    "speed_error": (
        "speed error",
        "m/s",
        "RMS of measured minus commanded velocity (vx, vy), sway of the gait included",
    ),
    "turn_error": ("turn error", "rad/s", "RMS of measured minus commanded turning (wz)"),
    "mse": (
        "MSE",
        "rad²",
        "mean of squared differences of joint positions, sample by sample, one joint",
    ),
    "unfolded_mse": (
        "unfolded MSE",
        "rad²",
        "as the authors of UniCon compute it: MSE of half a run, where it suits the beginning of "
        "the other run best, one joint",
    ),
    "wall_per_simulated_s": (
        "wall time",
        "s/s",
        "of a simulated second, policy included, from the first tick on",
    ),
}
"""Figure to heading, unit and meaning."""

FACTORS = {"distance_share": 100.0}


def heads(form: str = " [{}]") -> list[str]:
    """Return the headings of all columns, with their units in a form."""
    figures = [f"{name}{form.format(unit)}" for name, unit, _ in COLUMNS.values()]
    return ["platform", "runs", *figures, "falls", "outcome"]


def row(platform: Mapping[str, Any]) -> list[str]:
    """Return the cells of a platform."""
    done = platform["runs_done"]
    return [
        platform["platform"],
        f"{done}/{platform['runs_asked']}",
        *(cell(platform["figures"][key], FACTORS.get(key, 1.0)) for key in COLUMNS),
        str(platform["falls"]) if done else "–",
        OUTCOMES[platform["outcome"]],
    ]


def cell(figure: Mapping[str, Any], factor: float = 1.0) -> str:
    """Return mean ± standard deviation, – where there is nothing."""
    mean, std = figure["mean"], figure["std"]
    if mean is None:
        return "–"
    text = _number(factor * mean)
    return text if std is None else f"{text} ± {_number(factor * std, 2)}"


def _number(value: float, digits: int = 3) -> str:
    if value == 0.0:
        return "0"
    if not 1e-4 <= abs(value) < 1e6:
        return f"{value:.{digits - 1}e}"
    return f"{value:.{max(0, digits - 1 - math.floor(math.log10(abs(value))))}f}"


def table(result: Mapping[str, Any]) -> str:
    """Return all rows, what went wrong, and what was decided."""
    rows = [heads(), *(row(each) for each in result["platforms"])]
    workflow, first = result["workflow"], result["first"]
    lines = [f"{workflow['name']} on {result['robot'] or 'no robot'}, compared with {first}", ""]
    lines += aligned(rows, right=range(1, len(rows[0]) - 1))
    told = [f"{p['platform']}: {text}" for p in result["platforms"] for text in p["troubles"]]
    notes = list(result["notes"])
    if len(result["seeds"]) > 1:
        notes.append("± is the standard deviation over seeds (n − 1).")
    if result["interrupted"]:
        notes.append("It was interrupted: what was done until then is shown.")
    for more in (told, notes):
        lines += ["", *more] if more else []
    return "\n".join(lines)
