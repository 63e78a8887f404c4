"""Simulated time: physics steps in a tick, and time stamps that do not drift."""

from __future__ import annotations

import math
from fractions import Fraction

from unicon_base.errors import ModelError

MOST_STEPS = 10_000
"""Of a tick: with more nothing seems to go on."""


def steps_in(period: float, timestep: float, model: object, platform: str) -> int:
    """Return how many physics steps a tick has.

    Args:
        period: of a tick in [s].
        timestep: of the physics in [s].
        model: its file, for the message.
        platform: its name, likewise.

    Raises:
        ModelError: it is not a whole number of them, or has too many.
    """
    if not timestep >= period / MOST_STEPS:  # true for NaN too
        raise ModelError(
            f"a physics step of {timestep:.6g} s is too short for a tick of {period:.6g} s (model "
            f"{model}); write platforms: {{{platform}: {{timestep: {period / MOST_STEPS:.6g}}}}}, "
            "or more"
        )
    ratio = period / timestep
    steps = round(ratio)
    if steps >= 1 and abs(ratio - steps) < 1e-6 * steps:
        return steps
    down, up = max(math.floor(ratio), 1), max(math.ceil(ratio), 1)
    first, *others = (f"{period / n:.10g}" for n in dict.fromkeys((down, up)))
    either = "".join(f" (or {each})" for each in others)
    periods = " or ".join(f"{n * timestep:.6g}" for n in dict.fromkeys((down, up)))
    raise ModelError(
        f"a tick of {period:.6g} s is not a whole number of physics steps of {timestep:.6g} s "
        f"(model {model}); write platforms: {{{platform}: {{timestep: {first}}}}}{either}, or "
        f"correct the period to {periods}"
    )


def tick_ns(timestep: float, steps: int) -> Fraction | int:
    """Return the duration of a tick in [ns], exactly: its multiples are rounded only once."""
    exact = Fraction(repr(timestep)) * 10**9 * steps
    return int(exact) if exact.denominator == 1 else exact
