"""Divergence: which signal of two runs differed first, which then, and by how much.

    divergence(bring_together(real, sim, Options()))["signals"][0]["signal"]

Signals are the states of both runs, the terms of the observation, the action, and figures such as
the power. The first `HEALTHY_S` in which the policy acts in both runs, or of runs without one their
beginning, is taken to be healthy: it gives the level of each element's difference, the RMS. An
element differs where its difference exceeds `FACTOR` times that level in `HOLD` samples in a row,
from the sample on in which it left that level: what grows slowly began before it became large.
Bounds of that threshold follow from the variation, the element's standard deviation in the
simulated run:

- Runs that are not equal up to rounding at first differ by `SHARE` of it at least. Where an element
  is calm at first, as in a robot that stands and then walks, the level is no measure of what
  follows: the difference must exceed the whole variation.
- A fault from the beginning on is no level: the threshold is the variation at most, or that of
  white noise, which second differences tell from a movement.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from unicon_base.arrays import Array, Bool, Float64
from unicon_base.errors import UniconError, one_line
from unicon_core.metrics import rmse
from unicon_core.policies.controller import prefix_of
from unicon_core.policies.observation import Observation
from unicon_core.policies.policy_states import own_states
from unicon_core.states import States
from unicon_core.workflow.members import load_robot_of
from unicon_core.workflow.policies import load_policies
from unicon_lab.analysis.paired_runs import Together
from unicon_lab.analysis.run import Signals
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


def divergence(both: Together) -> dict[str, Any]:
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


def _divergence(both: Together, shift: int) -> dict[str, Any]:
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
