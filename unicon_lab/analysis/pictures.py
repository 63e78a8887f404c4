"""Pictures of a comparison, for the report and beside it."""

from __future__ import annotations

from typing import Any

import numpy as np

from unicon_core.drawing import INK, MARK, curve, grid, zoomed
from unicon_core.metrics import rmse, shift_losses
from unicon_lab.analysis.comparison import Comparison
from unicon_lab.analysis.run import TRACKING

REAL, SIM = MARK, "#e07b00"
CLOCK = "time of the real run [s]"
COLUMNS = 400
"""Of the heat map in time."""
TOP = 6
"""Joints whose curves are drawn."""
MOST = 32
"""Joints in the other pictures; the rest are in the table."""


def _alignment(figure: Any, comparison: Comparison) -> bool:
    both = comparison.together
    figure.set_size_inches(11.0, 3.0)
    axes = figure.add_subplot()
    real, sim = (
        side["joint_pos"][:end] for side, end in zip((both.real_whole, both.sim_whole), both.ends)
    )
    shifts, losses = shift_losses(real, sim)
    found = int(both.aligned.shift) * both.period
    curve(axes, shifts * both.period, losses, INK)
    axes.plot([found], [float(both.aligned.loss)], "o", color=REAL, label=f"found: {found:+.3f} s")
    axes.set(xlabel="shift of the simulated run [s]", ylabel="aligned MSE [rad²]")
    axes.legend()
    return True


def _curves(figure: Any, comparison: Comparison) -> bool:
    both, order = comparison.together, comparison.order[:TOP]
    real, sim = (side["joint_pos"][:, order] for side in (both.real, both.sim))
    zoomed(
        figure,
        [both.joints[k] for k in order],
        [("simulated", SIM, sim), ("real", REAL, real)],
        (real - sim) ** 2,
        both.period,
        both.begins[0],
        CLOCK,
    )
    return True


def _heat(figure: Any, comparison: Comparison) -> bool:
    both = comparison.together
    order = comparison.order[:MOST]
    figure.set_size_inches(12.0, 2.6 + 0.24 * len(order))
    above, below = figure.subplots(2, sharex=True, height_ratios=[1.0, 0.5 + 0.18 * len(order)])
    real, sim = both.real["joint_pos"], both.sim["joint_pos"]
    curve(above, both.time, rmse(real, sim, "frame"), INK)
    above.set_ylabel("RMSE of all [rad]")
    edges = np.unique(np.linspace(0, len(real), min(COLUMNS, len(real)) + 1).astype(int))
    squares = (real - sim)[:, order] ** 2
    means = np.add.reduceat(squares, edges[:-1], axis=0) / np.diff(edges)[:, None]
    image = below.imshow(
        np.sqrt(means).T,
        aspect="auto",
        cmap="magma",
        interpolation="nearest",
        extent=(both.time[0], both.time[-1] + both.period, len(order) - 0.5, -0.5),
    )
    below.set_yticks(range(len(order)), [both.joints[k] for k in order])
    below.grid(False)
    below.set_xlabel(CLOCK)
    figure.colorbar(image, ax=below, label="difference [rad]", pad=0.01)
    return True


def _tracking(figure: Any, comparison: Comparison) -> bool:
    both = comparison.together
    if TRACKING not in both.real:
        return False
    real, sim = both.real[TRACKING], both.sim[TRACKING]
    order = comparison.order[:MOST]
    every = grid(figure, len(order), 4, 1.6)
    for axes, k in zip(every, order):
        low, high = np.percentile(np.concatenate([real[:, k], sim[:, k]]), [0.2, 99.8])
        bins = np.linspace(low, max(high, low + 1e-6), 60)
        for values, colour, label in ((sim, SIM, "simulated"), (real, REAL, "real")):
            counts, _ = np.histogram(np.clip(values[:, k], bins[0], bins[-1]), bins)
            axes.stairs(counts, bins, fill=True, color=colour, alpha=0.55, label=label)
        axes.axvline(0.0, color=INK, linewidth=0.6)
        axes.set_title(both.joints[k])
        axes.set_yticks([])
    every[0].legend()
    figure.supxlabel("target − position [rad]")
    return True


_BARS = {"effort_rms": "RMS of torque [N·m]", "temperature_peak": "highest temperature [°C]"}


def _effort(figure: Any, comparison: Comparison) -> bool:
    order, figures = comparison.order[:MOST], comparison.joints
    names, places = [comparison.together.joints[k] for k in order], np.arange(len(order))
    shown = [key for key in _BARS if f"{key}_real" in figures]
    if not shown:
        return False
    figure.set_size_inches(11.0, 3.2 * len(shown))
    for axes, key in zip(figure.subplots(len(shown), squeeze=False)[:, 0], shown):
        for side, colour, at in (("real", REAL, -0.2), ("sim", SIM, 0.2)):
            axes.bar(places + at, figures[f"{key}_{side}"][order], 0.4, color=colour, label=side)
        axes.set_xticks(places, names, rotation=35, ha="right")
        axes.set_ylabel(_BARS[key])
        axes.legend()
    return True


# State, its column that is drawn, and label.
_OF_BASE = (
    ("projected_gravity", 2, "lean [rad]"),
    ("base_ang_vel", 2, "turning: z [rad/s]"),
    ("base_lin_vel", 0, "speed: x [m/s]"),
)


def _base(figure: Any, comparison: Comparison) -> bool:
    both = comparison.together
    shown = [each for each in _OF_BASE if each[0] in both.real]
    if not shown:
        return False
    figure.set_size_inches(12.0, 0.5 + 1.8 * len(shown))
    rows = figure.subplots(len(shown), sharex=True, squeeze=False)[:, 0]
    found = int(both.aligned.shift)
    begin = both.begins[0] - max(0, found) * both.period
    for axes, (name, column, label) in zip(rows, shown):
        sides = ((both.sim_whole, found, SIM, "simulated"), (both.real_whole, 0, REAL, "real"))
        for side, shift, colour, who in sides:
            values = side[name][:, column]
            if name == "projected_gravity":
                values = np.arccos(np.clip(-values, -1.0, 1.0))
            time = begin + both.period * (shift + np.arange(len(values)))
            curve(axes, time, values, colour, who)
        axes.axvspan(both.time[0], both.time[-1], color="0.5", alpha=0.1, label="compared")
        axes.set_ylabel(label)
    rows[0].legend(loc="upper left", ncols=3)
    rows[-1].set_xlabel(CLOCK)
    return True


PICTURES = {
    "alignment": (
        _alignment,
        "Alignment in time",
        "The simulated run is shifted so that all joint positions together differ least. Where the "
        "curve has many equal dips the movement repeats, and the smallest shift was taken.",
    ),
    "joints": (
        _curves,
        "The joints that differ most",
        "Positions after the shift; on the right the stretch that differs most (grey on the left).",
    ),
    "heat": (
        _heat,
        "When and where",
        "Difference of the positions after the shift: above of all joints in each sample, below of "
        "each joint, in the order of the gap.",
    ),
    "tracking": (
        _tracking,
        "Tracking error",
        "How often each joint was how far from its target. A weak motor is farther away, a joint "
        "whose zero is wrong is beside it, friction makes it broad.",
    ),
    "effort": (_effort, "Torque and temperature", "In the stretch that was compared."),
    "base": (
        _base,
        "The base",
        "From beginning to end, falls included; grey is what was compared.",
    ),
}
"""Name to function, heading and caption, in the report's order."""
