"""Pictures of a comparison, for the report and beside it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from unicon_core.drawing import COLOURS, INK, Curve, Lines, Panel, Pictures, worst
from unicon_core.metrics import rmse, shift_losses
from unicon_lab.analysis.comparison import Comparison
from unicon_lab.analysis.run import TRACKING

REAL, SIM = COLOURS[:2]
CLOCK = "time of the real run [s]"
TOP = 6
"""Joints whose curves are drawn."""


def worst_of(comparison: Comparison) -> tuple[float, float]:
    """Return from when to when the joint that differs most does so, in [s] of the real file."""
    both, k = comparison.together, comparison.order[0]
    off = both.real["joint_pos"][:, k] - both.sim["joint_pos"][:, k]
    return worst(off**2, both.period, both.begins[0])


def _alignment(comparison: Comparison) -> Iterator[Panel]:
    both = comparison.together
    real, sim = (
        side["joint_pos"][:end] for side, end in zip((both.real_whole, both.sim_whole), both.ends)
    )
    shifts, losses = shift_losses(real, sim)
    title = f"found: {int(both.aligned.shift) * both.period:+.3f} s"
    yield Panel(title, "rad²", [Curve("aligned MSE", REAL, shifts * both.period, losses)])


def _curves(state: str, unit: str) -> Callable[[Comparison], Iterator[Panel]]:
    """Return what draws a state of the joints that differ most, after the shift."""

    def panels(comparison: Comparison) -> Iterator[Panel]:
        both, shaded = comparison.together, [worst_of(comparison)]
        if state not in both.real or state not in both.sim:
            return
        real, sim = both.real[state], both.sim[state]
        every = Curve("RMSE", INK, both.time, rmse(real, sim, "frame"))
        yield Panel("RMSE of all joints", unit, [every], shaded)
        for k in comparison.order[:TOP]:
            sides = [Curve(who, colour, both.time, x[:, k]) for who, colour, x in _sides(sim, real)]
            yield Panel(both.joints[k], unit, sides, shaded)

    return panels


def _sides(sim: Any, real: Any) -> list[Any]:
    return [("simulated", SIM, sim), ("real", REAL, real)]


# State, its column that is drawn, what it is and its unit.
_OF_BASE = (
    ("projected_gravity", 2, "lean", "rad"),
    ("base_ang_vel", 2, "turning: z", "rad/s"),
    ("base_lin_vel", 0, "speed: x", "m/s"),
)


def _base(comparison: Comparison) -> Iterator[Panel]:
    both, found = comparison.together, int(comparison.together.aligned.shift)
    begin = both.begins[0] - max(0, found) * both.period
    for name, column, title, unit in _OF_BASE:
        curves = []
        for label, colour, side in _sides(both.sim_whole, both.real_whole):
            if name in both.real:
                values = side[name][:, column]
                if name == "projected_gravity":
                    values = np.arccos(np.clip(-values, -1.0, 1.0))
                ticks = np.arange(len(values)) + found * (label == "simulated")
                curves.append(Curve(label, colour, begin + both.period * ticks, values))
        yield Panel(title, unit, curves, [(both.time[0], both.time[-1])])


PICTURES: Pictures = {
    "alignment": (
        Lines(_alignment, "shift of the simulated run [s]"),
        "Alignment in time",
        "The simulated run is shifted so that all joint positions together differ least. Where the "
        "curve has many equal dips the movement repeats, and the smallest shift was taken.",
    ),
    "joints": (
        Lines(_curves("joint_pos", "rad"), CLOCK),
        "The joints that differ most",
        "Positions after the shift; grey is where the first joint differs most.",
    ),
    "tracking": (
        Lines(_curves(TRACKING, "rad"), CLOCK, 2),
        "Tracking error",
        "Target − position. A weak motor is farther away, one with a wrong zero is beside it.",
    ),
    "effort": (Lines(_curves("joint_effort", "N·m"), CLOCK, 2), "Torque", ""),
    "temperature": (Lines(_curves("motor_temperature", "°C"), CLOCK, 2), "Temperature", ""),
    "base": (
        Lines(_base, CLOCK),
        "The base",
        "From beginning to end, falls included; grey is what was compared.",
    ),
}
"""Name to function, heading and caption, in the report's order."""
