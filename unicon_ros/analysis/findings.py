"""Findings: what stands out in a comparison, in sentences, for the head of the report."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from unicon_ros.analysis.comparison import LAG_S, Comparison, gap_spread

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


def findings(comparison: Comparison) -> list[str]:
    """Return what stands out, the most important first."""
    both, joints = comparison.together, comparison.joints
    said = [_ranked(comparison), *_falls(both.falls)]
    least = np.minimum(*(side["joint_pos"].std(axis=0) for side in (both.real, both.sim)))
    still = least < MOVES_RAD
    for cycle in comparison.swapped:
        if still[list(cycle)].any():
            continue
        names = [both.joints[k] for k in cycle]
        said.append(
            f"{' and '.join(names)} look swapped: each moves as the other does in the simulator."
            if len(names) == 2
            else f"{', '.join(names)} look swapped in a ring."
        )
    correlation = np.where(still, 0.0, np.nan_to_num(joints["correlation"]))

    def tell(text: str, which: NDArray[np.bool_]) -> None:
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
    real, sim = falls
    if math.isnan(real) and math.isnan(sim):
        return []
    if math.isnan(sim):
        return [f"The real robot fell at {real:.2f} s, the simulated one did not."]
    if math.isnan(real):
        return [f"The simulated robot fell at {sim:.2f} s, the real one did not."]
    return [f"The real robot fell at {real:.2f} s, the simulated one at {sim:.2f} s of its run."]


def _names(comparison: Comparison, which: NDArray[np.bool_]) -> str:
    names = [comparison.together.joints[k] for k in comparison.order if which[k]]
    more = f" and {len(names) - 4} more" if len(names) > 4 else ""
    return ", ".join(names[:4]) + more
