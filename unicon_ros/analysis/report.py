"""Report of a comparison: one page that needs nothing beside it, PNGs, and JSON."""

from __future__ import annotations

import base64
import html
import json
import math
import os
from collections.abc import Callable
from pathlib import Path

from unicon_core import __version__
from unicon_core.errors import UniconError
from unicon_ros.analysis.comparison import Comparison
from unicon_ros.analysis.findings import findings
from unicon_ros.analysis.pictures import PICTURES, draw
from unicon_ros.analysis.run import Run

__all__ = ["SCHEMA", "write_report"]

SCHEMA = "unicon.analysis/1"

_COLUMNS = {
    "gap": ("gap", "rad", 1.0),
    "position_rmse": ("RMSE of position", "rad", 1.0),
    "position_bias": ("mean difference", "rad", 1.0),
    "tracking_rms_real": ("tracking error, real", "rad", 1.0),
    "tracking_rms_sim": ("tracking error, simulated", "rad", 1.0),
    "lag_s": ("lag", "ms", 1e3),
    "gain": ("gain", "", 1.0),
    "correlation": ("correlation", "", 1.0),
    "spectral_distance": ("spectral distance", "0 to 1", 1.0),
    "effort_ratio": ("torque RMS, real ÷ simulated", "", 1.0),
    "strength": ("torque for what is asked, real ÷ simulated", "", 1.0),
    "temperature_rise_real": ("warming, real", "K", 1.0),
    "temperature_rise_sim": ("warming, simulated", "K", 1.0),
}
"""Figure of a joint to heading, unit and factor in the table; the JSON has all of them."""

_STATE_COLUMNS = {
    "rmse_step_by_step": "RMSE sample by sample",
    "rmse_shifted": "RMSE after the shift",
    "unfolded_mse_of_shift": "unfolded MSE at that shift",
    "chamfer": "chamfer distance",
    "spectral_distance": "spectral distance",
}

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #222; margin: 2em auto; max-width: 1150px;
       padding: 0 1em; }
h1 { font-size: 1.6em; margin-bottom: 0; } h2 { font-size: 1.2em; margin: 2em 0 .3em; }
img { max-width: 100%; } .sub, figcaption { color: #666; } figure { margin: 0; }
figcaption { margin-bottom: .6em; }
ul.findings { background: #f2f5fb; border-left: 4px solid #1f4e9c; padding: .8em 1em .8em 2.2em; }
ul.findings li:first-child { font-weight: 600; }
.wide { overflow-x: auto; } table { border-collapse: collapse; font-size: 13px; }
th, td { padding: .25em .7em; text-align: right; border-bottom: 1px solid #ddd; }
th { vertical-align: bottom; font-weight: 600; }
td:first-child, th:first-child { text-align: left; }
th small { color: #666; font-weight: 400; } .facts td { text-align: left; }
"""


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
    said = findings(comparison)
    result: dict[str, object] = {
        "schema": SCHEMA,
        "unicon_ros": __version__,
        "real": _about(runs[0]),
        "sim": _about(runs[1]),
        "findings": said,
        **comparison.to_json(),
    }
    figures = []
    for name, (_, heading, caption) in PICTURES.items():
        tell(f"drawing {name}")
        if (picture := draw(name, comparison)) is None:
            continue
        _write(folder / f"{name}.png", picture)
        figures.append((heading, caption, picture))
    page = _page(comparison, runs, said, figures)
    _write(folder / "analysis.json", (json.dumps(result, indent=1) + "\n").encode())
    _write(folder / "report.html", page.encode())
    return result


def _about(run: Run) -> dict[str, object]:
    return {
        "file": str(run.path),
        "samples": len(run.time),
        "duration_s": float(run.time[-1]),
        "clock": run.clock,
        **run.about,
    }


def _write(path: Path, content: bytes) -> None:
    """Write a file so that nobody ever sees half of it."""
    half = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        half.write_bytes(content)
        half.replace(path)
    except OSError as error:
        half.unlink(missing_ok=True)
        raise UniconError(
            f"cannot write {path}: {error.strerror}; give a writable folder with room to --out"
        ) from error


def _page(
    comparison: Comparison,
    runs: tuple[Run, Run],
    said: list[str],
    figures: list[tuple[str, str, bytes]],
) -> str:
    names = tuple(html.escape(run.path.name) for run in runs)
    parts = [
        "<!DOCTYPE html>",
        '<html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        '<link rel="icon" href="data:,">',  # or browsers ask the server for one
        f"<title>{names[0]} and {names[1]}</title><style>{_STYLE}</style></head><body>",
        "<h1>How far the simulator is from the robot</h1>",
        f'<p class="sub">{names[0]} (real) and {names[1]} (simulated)</p>',
        f'<ul class="findings">{"".join(f"<li>{html.escape(text)}</li>" for text in said)}</ul>',
        "<h2>What was compared</h2>",
        _facts(comparison, runs),
        "".join(f"<p>{html.escape(note)}</p>" for note in comparison.together.notes),
    ]
    for place, (heading, caption, picture) in enumerate(figures):
        parts.append(_figure(heading, caption, picture))
        if place == 0:
            parts += ["<h2>Every joint</h2>", _joint_table(comparison)]
    parts += [
        "<h2>Every state</h2>",
        _state_table(comparison),
        f'<p class="sub">All figures, with all digits: analysis.json. unicon_ros {__version__}</p>',
        "</body></html>",
    ]
    return "\n".join(parts) + "\n"


def _facts(comparison: Comparison, runs: tuple[Run, Run]) -> str:
    both = comparison.together
    shift, count = int(both.unfolded.shift), len(both.time)
    later = {1: "; the real run is later", -1: "; the simulated run is later", 0: ""}
    letter = comparison.states["joint_pos"]["unfolded_to_the_letter"]
    facts = {
        "real": _in_words(runs[0]),
        "simulated": _in_words(runs[1]),
        "shift": f"{shift * both.period:+.3f} s ({shift:+d} samples)"
        + later[(shift > 0) - (shift < 0)],
        "compared": f"{count:,} samples at {1 / both.period:.4g} Hz, {both.time[0]:.2f} to "
        f"{both.time[-1]:.2f} s of the real run, {len(both.joints)} joints",
        "resampling": both.method,
        "unfolded MSE": f"{float(both.unfolded.loss):.4g} rad² of all joint positions; to the "
        f"letter, with norms that are not squared, {letter:.4g} rad",
        "ranked by": comparison.ranked_by,
    }
    rows = "".join(
        f"<tr><td>{html.escape(key)}</td><td>{html.escape(text)}</td></tr>"
        for key, text in facts.items()
    )
    return f'<div class="wide"><table class="facts">{rows}</table></div>'


def _in_words(run: Run) -> str:
    about = "".join(f", {key} {value}" for key, value in run.about.items())
    rate = (len(run.time) - 1) / run.time[-1]
    return (
        f"{run.path}{about}; {run.time[-1]:.2f} s, {len(run.time):,} samples, {rate:.4g} Hz "
        f"by {run.clock}"
    )


def _figure(heading: str, caption: str, picture: bytes) -> str:
    data = base64.b64encode(picture).decode()
    return (
        f"<h2>{html.escape(heading)}</h2><figure><figcaption>{html.escape(caption)}</figcaption>"
        f'<img alt="{html.escape(heading)}" src="data:image/png;base64,{data}"></figure>'
    )


def _joint_table(comparison: Comparison) -> str:
    columns = {key: shown for key, shown in _COLUMNS.items() if key in comparison.joints}
    heads = [
        f"{html.escape(name)}<br><small>{html.escape(unit)}</small>"
        for name, unit, _ in columns.values()
    ]
    rows = [
        [comparison.together.joints[k]]
        + [_number(factor * comparison.joints[key][k]) for key, (_, _, factor) in columns.items()]
        for k in comparison.order
    ]
    return _table(["joint", *heads], rows)


def _state_table(comparison: Comparison) -> str:
    rows = [
        [name, *(_number(figures[key]) for key in _STATE_COLUMNS)]
        for name, figures in comparison.states.items()
    ]
    return _table(["state", *_STATE_COLUMNS.values()], rows)


def _table(heads: list[str], rows: list[list[str]]) -> str:
    head = "".join(f"<th>{text}</th>" for text in heads)
    body = "".join(
        f"<tr>{''.join(f'<td>{html.escape(cell)}</td>' for cell in row)}</tr>" for row in rows
    )
    return f'<div class="wide"><table><tr>{head}</tr>{body}</table></div>'


def _number(value: float) -> str:
    return f"{value:.3g}" if math.isfinite(value) else "–"
