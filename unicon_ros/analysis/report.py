"""Report of a comparison: one page that needs nothing beside it, PNGs, and JSON."""

from __future__ import annotations

import html
import json
from collections.abc import Callable, Iterable
from pathlib import Path

from unicon_core import __version__
from unicon_core.page import findings, number, page, pairs, table, write_file
from unicon_ros.analysis.comparison import Comparison
from unicon_ros.analysis.findings import findings as found_in
from unicon_ros.analysis.pictures import PICTURES
from unicon_ros.analysis.run import Run
from unicon_ros.report.drawing import drawings

SCHEMA = "unicon.analysis/1"

_COLUMNS = {
    "gap": "gap\nrad",
    "position_rmse": "RMSE of position\nrad",
    "position_bias": "mean difference\nrad",
    "tracking_rms_real": "tracking error, real\nrad",
    "tracking_rms_sim": "tracking error, simulated\nrad",
    "lag_s": "lag\nms",
    "gain": "gain",
    "correlation": "correlation",
    "spectral_distance": "spectral distance\n0 to 1",
    "effort_ratio": "torque RMS, real ÷ simulated",
    "strength": "torque for what is asked, real ÷ simulated",
    "temperature_rise_real": "warming, real\nK",
    "temperature_rise_sim": "warming, simulated\nK",
}
"""Figure of a joint to heading and unit in the table; the JSON has all of them."""

_STATE_COLUMNS = {
    "rmse_step_by_step": "RMSE sample by sample",
    "rmse_shifted": "RMSE after the shift",
    "aligned_mse_of_shift": "aligned MSE at that shift",
    "chamfer": "chamfer distance",
    "spectral_distance": "spectral distance",
}


def write_report(
    comparison: Comparison, runs: tuple[Run, Run], folder: Path, tell: Callable[[str], None]
) -> dict[str, object]:
    """Write `report.html`, `analysis.json` and a PNG for each picture.

    Args:
        comparison: what is reported.
        runs: the real and the simulated one.
        folder: where to; files of these names are replaced.
        tell: takes what is being drawn.

    Returns:
        What the JSON has.

    Raises:
        UniconError: a file cannot be written.
    """
    said = found_in(comparison)
    result: dict[str, object] = {
        "schema": SCHEMA,
        "unicon_ros": __version__,
        "real": _about(runs[0]),
        "sim": _about(runs[1]),
        "findings": said,
        **comparison.to_json(),
    }
    text = _page(comparison, runs, said, drawings(PICTURES, comparison, folder=folder, tell=tell))
    write_file(folder / "analysis.json", (json.dumps(result, indent=1) + "\n").encode())
    write_file(folder / "report.html", text.encode())
    return result


def _about(run: Run) -> dict[str, object]:
    return {
        "file": str(run.path),
        "samples": len(run.time),
        "duration_s": float(run.time[-1]),
        "clock": run.clock,
        **run.about,
    }


def _page(
    comparison: Comparison,
    runs: tuple[Run, Run],
    said: list[str],
    figures: Iterable[tuple[str, str]],
) -> str:
    parts = [
        findings(said),
        "<h2>What was compared</h2>",
        _facts(comparison, runs),
        "".join(f"<p>{html.escape(note)}</p>" for note in comparison.together.notes),
    ]
    for name, shown in figures:
        parts.append(shown)
        if name == "ranking":
            parts += ["<h2>Every joint</h2>", _joint_table(comparison)]
    parts += [
        "<h2>Every state</h2>",
        _state_table(comparison),
        f'<p class="sub">All figures, with all digits: analysis.json. unicon_ros {__version__}</p>',
    ]
    title = f"{runs[0].path.name} (real) and {runs[1].path.name} (simulated)"
    return page(title, "How far the simulator is from the robot", parts)


def _facts(comparison: Comparison, runs: tuple[Run, Run]) -> str:
    both = comparison.together
    shift, count = int(both.aligned.shift), len(both.time)
    later = {1: "; the real run is later", -1: "; the simulated run is later", 0: ""}
    unfolded = comparison.states["joint_pos"]["unfolded_mse"]
    facts = {
        "real": _in_words(runs[0]),
        "simulated": _in_words(runs[1]),
        "shift": f"{shift * both.period:+.3f} s ({shift:+d} samples)"
        + later[(shift > 0) - (shift < 0)],
        "compared": f"{count:,} samples at {1 / both.period:.4g} Hz, {both.time[0]:.2f} to "
        f"{both.time[-1]:.2f} s of the real run, {len(both.joints)} joints",
        "resampling": both.method,
        "aligned MSE": f"{float(both.aligned.loss):.4g} rad², summed over joints, at that shift",
        "unfolded MSE": f"{unfolded:.4g} rad², mean of a joint, as UniCon's authors compute it",
        "ranked by": comparison.ranked_by,
    }
    return pairs(facts)


def _in_words(run: Run) -> str:
    about = "".join(f", {key} {value}" for key, value in run.about.items())
    rate = (len(run.time) - 1) / run.time[-1]
    return (
        f"{run.path}{about}; {run.time[-1]:.2f} s, {len(run.time):,} samples, {rate:.4g} Hz "
        f"by {run.clock}"
    )


def _joint_table(comparison: Comparison) -> str:
    columns = [key for key in _COLUMNS if key in comparison.joints]
    heads = ["joint", *(_COLUMNS[key] for key in columns)]
    figures = comparison.joints | {"lag_s": 1e3 * comparison.joints["lag_s"]}
    rows = [
        [comparison.together.joints[k], *(number(figures[key][k]) for key in columns)]
        for k in comparison.order
    ]
    return table(heads, rows)


def _state_table(comparison: Comparison) -> str:
    rows = [
        [name, *(number(figures[key]) for key in _STATE_COLUMNS)]
        for name, figures in comparison.states.items()
    ]
    return table(["state", *_STATE_COLUMNS.values()], rows)
