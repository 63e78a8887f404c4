"""Comparison: every figure of the report, of two runs that were brought together.

`divergence` tells which of their signals differed first, which then, and by how much. Signals are
the states of both runs, the terms of the observation, the action, and figures such as the power.
The first `HEALTHY_S` in which the policy acts in both runs, or of runs without one their beginning,
is taken to be healthy: it gives the level of each element's difference, the RMS. An element differs
where its difference exceeds `FACTOR` times that level in `HOLD` samples in a row, from the sample
on in which it left that level: what grows slowly began before it became large. Bounds of that
threshold follow from the variation, the element's standard deviation in the simulated run:

- Runs that are not equal up to rounding at first differ by `SHARE` of it at least. Where an element
  is calm at first, as in a robot that stands and then walks, the level is no measure of what
  follows: the difference must exceed the whole variation.
- A fault from the beginning on is no level: the threshold is the variation at most, or that of
  white noise, which second differences tell from a movement.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from unicon_base import AnyDict, UniconError, one_line
from unicon_base.arrays import Array, Bool, Float64
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
from unicon_core.policies.controller import prefix_of
from unicon_core.policies.observation import Observation
from unicon_core.policies.policy_states import own_states
from unicon_core.states import States
from unicon_core.workflow.members import load_robot_of
from unicon_core.workflow.policies import load_policies
from unicon_lab.analysis.paired_runs import Together
from unicon_lab.analysis.run import TRACKING, Signals
from unicon_lab.recording import Record
from unicon_lab.replay.workflow import workflow_of

HEALTHY_S = 1.0
"""Beginning of the common stretch in [s] that gives the levels; a quarter of it at most."""
FACTOR = 4.0
"""Level times this is a difference: white noise exceeds it in 3 of 10¹³ triples of samples."""
HOLD = 3
"""Samples in a row that must differ: fewer are a spike."""
NORMAL = 0.6745
"""Median of the size of normal noise as a share of its standard deviation."""
SHARE = 0.25
"""Of its variation by which an element differs at least, where the runs are not equal at first."""
CALM = 0.5
"""Share of its variation below which an element is calm."""
ROUNDING = 1e-5
"""Of the largest value: processors round otherwise."""


def divergence(both: Together) -> AnyDict:
    """Return in which order the signals of two runs began to differ.

    The runs are compared sample by sample without a shift or with that of the comparison, under
    which they agree longer.

    Returns:
        `shift_s` of the simulated run; `healthy_s`: from when to when the levels are from;
        `agree_s`: time to the first difference, infinite without one; `signals`, the first to
        differ first, each with its name as `signal`, its `rank` in this order (the same for signals
        that began in one sample, None for those that do not differ), `time_s` in the real file, the
        `element` in which it began, `size`: RMS of its difference over all elements and all that
        was compared, in the signal's unit, and `relative`: size ÷ standard deviation of the signal
        in the simulated run.
    """
    shifts = dict.fromkeys((0, int(both.aligned.shift)))
    found = [_divergence(both, shift) for shift in shifts]
    return max(found, key=lambda each: float(each["agree_s"]))


def _divergence(both: Together, shift: int) -> AnyDict:
    period, skipped = both.period, (max(0, shift), max(0, -shift))
    count = min(end - first for end, first in zip(both.ends, skipped))
    length = max(HOLD, min(round(HEALTHY_S / period), count // 4))
    real, sim = (
        {name: side[name][first : first + count] for name in both.real_whole if name in side}
        for side, first in zip((both.real_whole, both.sim_whole), skipped)
    )
    acts = next((name for name in real if name.endswith("action")), "joint_pos")
    moved = [int(np.argmax((run[acts] != run[acts][0]).any(axis=1))) for run in (real, sim)]
    first = min(max(moved), count - length)
    healthy = slice(first, first + length)
    begin = both.begins[0] + (skipped[0] - max(0, int(both.aligned.shift))) * period
    found = [(*_onset(real[name] - usual, usual, healthy), name) for name, usual in sim.items()]
    found.sort(key=lambda each: each[0])
    steps, signals = [*dict.fromkeys(onset for onset, _, _ in found)], []
    for onset, column, name in found:
        differs, size = onset < math.inf, float(rmse(real[name], sim[name]))
        variation = float(np.sqrt(sim[name].var(axis=0).mean()))
        signals.append(
            {
                "signal": name,
                "rank": steps.index(onset) + 1 if differs else None,
                "time_s": begin + onset * period,
                "element": both.elements.get(name, ("",))[column] if differs else "",
                "size": size,
                "relative": size / variation if variation else math.nan,
            }
        )
    return {
        "shift_s": shift * period,
        "healthy_s": [begin + at * period for at in (first, first + length)],
        "agree_s": found[0][0] * period,
        "signals": signals,
    }


def _onset(off: Float64, sim: Float64, healthy: slice) -> tuple[float, int]:
    """Return the sample in which a signal began to differ, infinity for never, and the element.

    Args:
        off: difference, shape (n, d).
        sim: the simulated run, likewise.
        healthy: samples that give the levels.
    """
    first, variation = off[healthy], sim.std(axis=0)
    level = np.sqrt(np.mean(first**2, axis=0))
    # Of white noise σ the second difference has √6 σ; the median of its size is `NORMAL` of that.
    noise = np.median(np.abs(np.diff(first, 2, axis=0)), axis=0) / (NORMAL * math.sqrt(6.0))
    most = np.maximum(FACTOR * noise, variation)
    spread = np.abs(sim[healthy] - np.median(sim[healthy], axis=0))
    rounding = ROUNDING * np.abs(sim).max(axis=0)
    low = np.maximum(np.minimum(FACTOR * level, most), rounding)
    calm = np.median(spread, axis=0) < CALM * NORMAL * variation
    share = np.where(level > rounding, np.where(calm, 1.0, SHARE), 0.0)
    size: Float64 = np.abs(off)
    beyond = size > np.maximum(low, share * variation)
    differs: Bool = np.all(sliding_window_view(beyond, HOLD, axis=0), axis=-1)
    onsets = np.full(off.shape[1], math.inf)
    for k in np.flatnonzero(differs.any(axis=0)).tolist():
        before = np.flatnonzero(size[: int(np.argmax(differs[:, k])), k] <= low[k])
        onsets[k] = before[-1] + 1 if before.size else 0
    element = int(onsets.argmin())
    return float(onsets[element]), element


def signals_of(record: Record, notes: list[str]) -> Signals:
    """Return what the policies saw and did, and which feet stood, as far as a record has it.

    Args:
        record: of one robot.
        notes: take what is missing, in a sentence.

    Returns:
        `observation TERM`, its newest frame, of each policy's contract as its file is now;
        `action`; `foot_contact` of leg odometry.
    """
    specs, keys = record.layout.specs, record.policies
    found, elements = dict[str, Array](), dict[str, tuple[str, ...]]()
    for name in (*(f"{prefix_of(key, keys)}action" for key in keys), "foot_contact"):
        if name in specs:
            found[name], elements[name] = record.states(name), specs[name].names
    if not keys:
        return found, elements
    try:
        document, states = workflow_of(record), States(record.layout)
        for key, contract in load_policies(document, load_robot_of(document)).items():
            prefix = prefix_of(key, keys)
            name = f"{prefix}observation"
            if name not in specs:
                continue
            seen, values = own_states(contract, states, prefix)[0], record.states(name)
            observation = Observation(contract, seen, specs["joint_pos"].names)
            if observation.size != values.shape[1]:
                raise UniconError(
                    f"{contract.path} has {observation.size} values, the record "
                    f"{values.shape[1]}; restore the recorded file"
                )
            places = [observation.element_of(k) for k in range(observation.size)]
            for part in observation.slices:
                newest = [k for k, (each, _, age) in enumerate(places) if each is part and not age]
                term = f"{name} {part.term.name}"
                found[term] = values[:, newest]
                elements[term] = part.names or tuple(map(str, part.elements))
    except UniconError as error:
        file = record.paths[0].name
        notes.append(f"{file}: its observation is not compared: {one_line(error)}")
    return found, elements


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
    divergence: AnyDict

    def to_json(self) -> AnyDict:
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
    return kp * (target - states["joint_pos"][1:]) + kd * (speed - states["joint_vel"][1:]) + torque


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
