"""Report of a comparison: what stands out, a page that needs nothing beside it, PNGs, and JSON."""

from __future__ import annotations

import html
import math
from itertools import groupby
from pathlib import Path

import numpy as np

from unicon_base import AnyDict, AnyMapping, TextSink
from unicon_base.arrays import Bool
from unicon_base.located_yaml import read_yaml
from unicon_core import __version__
from unicon_core.check.subject import listed
from unicon_core.drawing import drawings
from unicon_core.page import (
    Html,
    answers,
    findings,
    link,
    number,
    page,
    pairs,
    table,
    write_file,
    write_json,
)
from unicon_lab.analysis.comparison import FACTOR, LAG_S, SIDES, Comparison, gap_spread
from unicon_lab.analysis.pictures import PICTURES, worst_of
from unicon_lab.analysis.run import Run
from unicon_lab.report import words

SCHEMA = "unicon.analysis/1"
STEPS = 3
"""Of the divergence, in the headline."""

# Figure of a joint to heading and unit in the table; the JSON has all of them.
_COLUMNS: dict[str, str] = read_yaml(Path(__file__).with_suffix(".yaml")).value


def write_report(
    comparison: Comparison, runs: tuple[Run, Run], folder: Path, tell: TextSink
) -> AnyDict:
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
    both = comparison.together
    said = [*findings_of(comparison), _headline(comparison.divergence)]
    about = {
        who: {
            "file": str(run.path),
            "samples": len(run.time),
            "duration_s": float(run.time[-1]),
            "clock": run.clock,
            **run.about,
        }
        for who, run in zip(SIDES, runs)
    }
    result = {
        "schema": SCHEMA,
        "unicon_ros": __version__,
        **about,
        "findings": said,
        **comparison.to_json(),
    }
    facts = {
        who: ", ".join(f"{key} {value}" for key, value in run.items()) for who, run in about.items()
    }
    facts |= {key: str(result[key]) for key in ("method", "shift_s", "samples", "ranked_by")}
    facts |= {key: number(value) for key, value in comparison.states["joint_pos"].items()}
    parts = [
        _answers(comparison, runs, folder),
        findings(said),
        "<h2>What differed first</h2>",
        table(HEADS, chain_rows(comparison.divergence)),
        "<h2>What was compared</h2>",
        pairs(facts),
        *(f"<p>{html.escape(note)}</p>" for note in both.notes),
        "<h2>Every joint</h2>",
        _joint_table(comparison),
        *(shown for _, shown in drawings(PICTURES, comparison, folder=folder, tell=tell)),
        f'<p class="sub">All figures, with all digits: analysis.json. unicon_ros {__version__}</p>',
    ]
    title = f"{runs[0].path.name} (real) and {runs[1].path.name} (simulated)"
    text = page(title, "How far the simulator is from the robot", parts)
    write_json(folder / "analysis.json", result)
    write_file(folder / "report.html", text.encode())
    return result


def _answers(comparison: Comparison, runs: tuple[Run, Run], folder: Path) -> str:
    real, sim = (words(run.states, comparison.together.period) for run in runs)
    fast, fell, asked = (a if a == b else f"real {a}; simulated {b}" for a, b in zip(real, sim))
    begin, end = worst_of(comparison)
    when = f"differs most from {begin:.2f} to {end:.2f} s of the real run"
    where = " and ".join(link(run.path, folder, run.path.name) for run in runs)
    return answers(_ranked(comparison), when, fast, fell, asked, Html(where))


HEADS = ("signal", "rank", "first in", "from [s]", "RMS of difference", "÷ variation")


def chain_rows(found: AnyMapping) -> list[list[str]]:
    """Return the cells of a divergence, a row for each signal, under `HEADS`."""
    return [
        [
            each["signal"],
            number(each["rank"]),
            each["element"],
            f"{each['time_s']:.3f}" if each["rank"] else "–",
            number(each["size"]),
            number(each["relative"]),
        ]
        for each in found["signals"]
    ]


def _headline(found: AnyMapping) -> str:
    """Return the first steps of a divergence in words."""
    steps = []
    for rank, step in groupby(found["signals"], lambda each: each["rank"]):
        alike = [*step]
        if rank in range(1, STEPS + 1):
            names = listed(each["signal"] for each in alike)
            steps.append(f"{names} at {alike[0]['time_s']:.3f} s")
    if steps:
        return f"First to differ: {'; then '.join(steps)}."
    first, last = found["healthy_s"]
    usual = f"what it does from {first:.2f} to {last:.2f} s"
    return f"No signal differs by more than {FACTOR:g} times {usual}."


def _joint_table(comparison: Comparison) -> str:
    columns = [key for key in _COLUMNS if key in comparison.joints]
    heads = ["joint", *(_COLUMNS[key] for key in columns)]
    figures = comparison.joints | {"lag_s": 1e3 * comparison.joints["lag_s"]}
    rows = [
        [comparison.together.joints[k], *(number(figures[key][k]) for key in columns)]
        for k in comparison.order
    ]
    return table(heads, rows)


SURE = 0.8
"""|correlation| from which on gain and sign of a joint that moves mean something."""
VERY_SURE = 0.95
"""The same of a lag: curves of another shape have one, too."""
MOVES_RAD = 0.02
"""Standard deviation of a position in [rad] from which a joint moves. Noise n makes the gain of a
spread s smaller by (n / s)²: by 8 % for n = 0.006, which is that of the ±0.01 rad in training and
more than an encoder's. go2_walk has 0.040 or more, its hips straight ahead 0.011; stands 0.003."""
LAG_SAMPLES = 2
"""By which a joint is later than most of the others."""
GAIN = 1.25
"""Factor by which a joint moves more or less."""
BIAS = 0.04
"""Constant difference of a position in [rad]; encoders are set to within 0.02."""
STRENGTH = 1.2
"""Factor by which a joint's torque differs from what is asked."""
WARMER_K = 5.0


def findings_of(comparison: Comparison) -> list[str]:
    """Return what stands out, the most important first."""
    both, joints = comparison.together, comparison.joints
    said = [_ranked(comparison), *_falls(both.falls)]
    least = np.minimum(*(side["joint_pos"].std(axis=0) for side in (both.real, both.sim)))
    still = least < MOVES_RAD
    for cycle in comparison.swapped:
        if still[list(cycle)].any():
            continue
        names = " and ".join(both.joints[k] for k in cycle)
        said.append(f"{names} look swapped: each moves as another does in the simulator.")
    correlation = np.where(still, 0.0, np.nan_to_num(joints["correlation"]))

    def tell(text: str, which: Bool) -> None:
        if which.any():
            said.append(f"{text}: {_names(comparison, which)}.")

    tell("A sign seems to be turned", correlation <= -SURE)
    if "strength" in joints:
        strength = np.where(np.isfinite(joints["strength"]), joints["strength"], 1.0)
        less, more = strength <= 1.0 / STRENGTH, strength >= STRENGTH
        tell(f"Less torque for what is asked, down to {100 * strength.min():.0f} %", less)
        tell(f"More torque for what is asked, up to {100 * strength.max():.0f} %", more)
    if "temperature_rise_real" in joints:
        warmer = joints["temperature_rise_real"] - joints["temperature_rise_sim"]
        tell(f"Warms more, by up to {warmer.max():.0f} K", warmer >= WARMER_K)
    lag = joints["lag_s"] - np.median(joints["lag_s"])
    # What is found at the end of the window is not a delay: the curves differ in shape.
    late = (correlation >= VERY_SURE) & (joints["lag_s"] < 0.9 * LAG_S)
    late &= lag >= (LAG_SAMPLES - 0.5) * both.period
    tell(f"Later than the other joints, by up to {1e3 * lag[late].max(initial=0):.0f} ms", late)
    gain = np.where(correlation >= SURE, joints["gain"], 1.0)
    tell(f"Moves farther, up to {gain.max():.2f} times as far", gain >= GAIN)
    tell(f"Moves less far, down to {gain.min():.2f} times as far", gain <= 1.0 / GAIN)
    bias = np.abs(joints["position_bias"])
    beside = (bias >= BIAS) & (bias**2 > 0.5 * joints["position_rmse"] ** 2)
    tell(f"Off by a constant, up to {bias.max():.2f} rad (a wrong zero, or a weak motor)", beside)
    if joints["gap"].any():
        small = f"below {MOVES_RAD:g} rad rms in a run"
        tell(f"Hardly moves ({small}): sign, range and lag not judged", still)
    return said


def _ranked(comparison: Comparison) -> str:
    """Name the joint that differs most, or those that differ as much within their gaps' spread."""
    both, order, gap = comparison.together, comparison.order, comparison.joints["gap"]
    first = order[0]
    if gap[first] == 0.0:
        return "No joint differs."
    spread = gap_spread(both)
    alike = [k for k in order if gap[first] - gap[k] <= 2.0 * np.hypot(spread[first], spread[k])]
    measure = comparison.ranked_by.removesuffix(" in rad")
    if len(alike) == 1:
        text = f"{both.joints[first]} differs most, by {gap[first]:.3g} rad"
        if len(order) > 1 and gap[order[1]] > 0.0:
            text += f", {gap[first] / gap[order[1]]:.1f} times as much as {both.joints[order[1]]}"
        return f"{text} ({measure})."
    which = np.isin(np.arange(len(gap)), alike)
    text = f"No joint stands out: {_names(comparison, which)} differ alike"
    least = float(gap[alike].min())
    return f"{text}, by {least:.3g} to {gap[first]:.3g} rad ({measure})."


def _falls(falls: tuple[float, float]) -> list[str]:
    if all(map(math.isnan, falls)):
        return []
    real, sim = (
        "did not fall" if math.isnan(at) else f"fell at {at:.2f} s of its run" for at in falls
    )
    return [f"The real robot {real}, the simulated one {sim}."]


def _names(comparison: Comparison, which: Bool) -> str:
    return listed(comparison.together.joints[k] for k in comparison.order if which[k])
