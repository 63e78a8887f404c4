"""Comparison: every figure of the report, of two runs that were brought together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from unicon_base.arrays import Float64
from unicon_core.metrics import (
    affine,
    chamfer,
    compare,
    load,
    match_elements,
    rmse,
    spectral_distance,
    unfolded_mse,
    warming,
    wasserstein,
)
from unicon_core.metrics.elements import windows
from unicon_core.page import plain
from unicon_lab.analysis.divergence import divergence
from unicon_lab.analysis.paired_runs import Together
from unicon_lab.analysis.run import TRACKING

LAG_S = 0.1
"""Largest lag of a joint against the others in [s]: less than a quarter of a stride."""
SMOOTHED_S = 0.1
"""Over which torques are averaged in [s] before they are held against what was asked."""
STRETCHES = 8
"""Of a comparison, whose gaps tell by how much the gap of a joint may differ by chance."""
SIDES = ("real", "sim")
PATHS = 2000
"""Samples of each run at most for the chamfer distance, evenly taken: it grows with the square."""


@dataclass(frozen=True)
class Comparison:
    """What a comparison says.

    Attributes:
        together: the runs.
        ranked_by: what `gap` of a joint is, in words.
        order: joints from the largest gap to the smallest, as their columns.
        joints: figure to a value for each joint, in their columns' order. NaN: there is none.
        states: name to figure to value, for each state as a whole.
        swapped: joints whose movements are swapped, as cycles of their columns.
        divergence: what differed first, as of `divergence`.
    """

    together: Together
    ranked_by: str
    order: list[int]
    joints: dict[str, Float64]
    states: dict[str, dict[str, float]]
    swapped: list[tuple[int, ...]]
    divergence: dict[str, Any]

    def to_json(self) -> dict[str, Any]:
        """Return all of it as plain values, joints in the order of their rank."""
        both = self.together
        names = both.joints
        values = {
            "period_s": both.period,
            "method": both.method,
            "shift_samples": int(both.aligned.shift),
            "shift_s": int(both.aligned.shift) * both.period,
            "samples": int(both.aligned.overlap),
            "begins_s": dict(zip(SIDES, both.begins)),
            "fall_s": dict(zip(SIDES, both.falls)),
            "ranked_by": self.ranked_by,
            "joints": [
                {"name": names[k], "rank": rank}
                | {figure: float(values[k]) for figure, values in self.joints.items()}
                for rank, k in enumerate(self.order, 1)
            ],
            "states": self.states,
            "swapped_joints": [[names[k] for k in cycle] for cycle in self.swapped],
            "divergence": self.divergence,
            "notes": both.notes,
        }
        return dict(plain(values))


def gap_spread(both: Together) -> Float64:
    """Return the standard error of each joint's gap in [rad], from equal stretches of time.

    Joints whose gaps are nearer to each other than that differ as much.
    """
    real, sim, _ = _ranked(both)
    count = min(STRETCHES, len(real))
    gaps = [
        wasserstein(a, b) for a, b in zip(np.array_split(real, count), np.array_split(sim, count))
    ]
    return np.asarray(np.std(gaps, axis=0) / np.sqrt(count), np.float64)


def _ranked(both: Together) -> tuple[Float64, Float64, str]:
    """Return what ranks the joints, of both runs, shape (n, d), and what it is."""
    name = TRACKING if TRACKING in both.real else "joint_pos"
    return both.real[name], both.sim[name], name


def compare_runs(both: Together) -> Comparison:
    """Return all figures."""
    real, sim = both.real, both.sim
    lag = max(1, round(LAG_S / both.period))
    position = affine(real["joint_pos"], sim["joint_pos"], lag)
    joints: dict[str, Float64] = {
        "position_rmse": rmse(real["joint_pos"], sim["joint_pos"], "element"),
        "position_bias": np.mean(real["joint_pos"] - sim["joint_pos"], axis=0),
        "lag_s": np.multiply(position.lag, both.period, dtype=np.float64),
        "gain": position.gain,
        "offset": position.offset,
        "sign": position.sign.astype(np.float64),
        "correlation": position.correlation,
        "spectral_distance": spectral_distance(real["joint_pos"], sim["joint_pos"]),
    }
    real_ranked, sim_ranked, what = _ranked(both)
    ranked_by = (
        f"distance of the distributions of the {what.replace('_', ' ')} (Wasserstein-1) in rad"
    )
    gap = wasserstein(real_ranked, sim_ranked)
    if what == TRACKING:
        for who, error in zip(SIDES, (real_ranked, sim_ranked)):
            joints[f"tracking_rms_{who}"] = np.sqrt(np.mean(error**2, axis=0))
    joints = {"gap": gap} | joints | _strain(both)
    return Comparison(
        both,
        ranked_by,
        sorted(range(len(both.joints)), key=lambda k: -float(gap[k])),
        joints,
        {name: _whole(name, both) for name in real},
        match_elements(real["joint_pos"], sim["joint_pos"]).cycles(),
        divergence(both),
    )


def _strain(both: Together) -> dict[str, Float64]:
    """Return what torques and temperatures tell, where both runs have them."""
    figures: dict[str, Float64] = {}
    asks = {*_ASKED} <= both.real.keys()
    for who, side in zip(SIDES, (both.real, both.sim)):
        if "joint_effort" in side:
            effort = side["joint_effort"]
            figures[f"effort_rms_{who}"] = load(effort).rms
            if asks:
                # Asked of what was given: speeds are noisier than torques, and noise in what is
                # given would make every gain smaller. The mean over a moment makes it smaller
                # still.
                width = max(1, min(round(SMOOTHED_S / both.period), len(effort) // 4))
                starts = np.arange(len(effort) - width)
                asked, given = (windows(x, starts, width) for x in (_asked(side), effort[1:]))
                figures[f"asked_{who}"] = affine(asked, given, 0).gain
        if "motor_temperature" in side:
            warm = warming(side["motor_temperature"], both.period)
            figures[f"temperature_rise_{who}"] = warm.rise
            figures[f"temperature_peak_{who}"] = warm.peak
    if "effort_rms_sim" in figures:
        figures["effort_ratio"] = compare(figures["effort_rms_real"], figures["effort_rms_sim"])
    if "asked_sim" in figures:
        figures["strength"] = compare(figures.pop("asked_sim"), figures.pop("asked_real"))
    return figures


_ASKED = ("joint_pos_target", "joint_stiffness", "joint_damping", "joint_vel")


def _asked(states: dict[str, Float64]) -> Float64:
    """Return the torque in [N·m] that is asked for when the next sample is taken, shape (n − 1, d).

    kp (q* − q) + kd (q̇* − q̇) + τ_ff: the command is the last one's, q and q̇ are the next one's.
    """
    target, kp, kd, _ = (states[name][:-1] for name in _ASKED)
    speed, torque = (
        states[name][:-1] if name in states else np.zeros_like(target)
        for name in ("joint_vel_target", "joint_effort_ff")
    )
    return np.asarray(
        kp * (target - states["joint_pos"][1:]) + kd * (speed - states["joint_vel"][1:]) + torque
    )


def _whole(name: str, both: Together) -> dict[str, float]:
    """Return the figures of a state as a whole."""
    real, sim = both.real[name], both.sim[name]
    count = min(both.ends)
    step = max(1, len(real) // PATHS)
    figures = {
        "rmse_step_by_step": float(
            rmse(both.real_whole[name][:count], both.sim_whole[name][:count])
        ),
        "rmse_shifted": float(rmse(real, sim)),
        "chamfer": float(chamfer(real[::step], sim[::step])),
        "spectral_distance": float(np.mean(spectral_distance(real, sim))),
    }
    if name == "joint_pos":
        figures["aligned_mse"] = float(both.aligned.loss)
        figures["unfolded_mse"] = float(unfolded_mse(*both.unshifted))
    return figures
