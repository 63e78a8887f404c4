"""Together: two runs brought to the same joints, one rate, one length and the shift that suits."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from unicon_base import UniconError
from unicon_base.arrays import Float64
from unicon_core.metrics import Aligned, aligned_mse, fall_time
from unicon_lab.analysis.run import BASE, FEWEST, JOINTS, Run

HOLE = 10.0
"""Periods without a sample that are told of."""


@dataclass(frozen=True)
class Together:
    """Two runs that can be compared sample by sample.

    Attributes:
        joints: names of those that both have, in the real robot's order.
        period: between two samples in [s].
        method: how both came to it, in words.
        aligned: of the joint positions, in samples.
        real, sim: states that both have, shifted and of one length, shape (n, d).
        real_whole, sim_whole: all states before the shift and the cut at a fall, and `Run.broken`.
        ends: samples of each of these that the cut at a fall leaves.
        begins: time of the first common sample in the real file and in the simulated one, in [s].
        falls: when each fell in [s] of its file, NaN for not at all.
        elements: name of a state or signal to names of its elements.
        notes: what was left out or assumed, in sentences.
    """

    joints: tuple[str, ...]
    period: float
    method: str
    aligned: Aligned
    real: dict[str, Float64]
    sim: dict[str, Float64]
    real_whole: dict[str, Float64]
    sim_whole: dict[str, Float64]
    ends: tuple[int, int]
    begins: tuple[float, float]
    falls: tuple[float, float]
    elements: dict[str, tuple[str, ...]]
    notes: list[str]

    @property
    def unshifted(self) -> tuple[Float64, Float64]:
        """Joint positions up to a fall in either run, from both beginnings, shape (n, d) each."""
        count = min(self.ends)
        return self.real_whole["joint_pos"][:count], self.sim_whole["joint_pos"][:count]

    @property
    def time(self) -> Float64:
        """Time of each common sample in [s] of the real file."""
        count = len(self.real["joint_pos"])
        return np.asarray(self.begins[0] + self.period * np.arange(count), np.float64)


def bring_together(
    real: Run,
    sim: Run,
    max_shift: float | None = None,
    rate: float | None = None,
    whole: bool = False,
) -> Together:
    """Bring two runs together.

    Args:
        real: one run.
        sim: the other.
        max_shift: largest |shift| in [s], None for all that leave half of the shorter run.
        rate: in [Hz] at which both are compared, None for the slower one's.
        whole: compare what comes after a fall, too.

    Raises:
        UniconError: no joint in common, or too little in common in time.
    """
    notes = [*real.notes, *sim.notes]
    joints, columns = _joints(real, sim, notes)
    period, method = common_period(real, sim, rate)
    runs, sides, known = (real, sim), [], {*JOINTS, *BASE}
    for run, other, column in zip(runs, runs[::-1], columns):
        signals = {**run.states, **run.broken}
        if missing := [n for n in {**other.states, **other.broken} if n not in signals]:
            notes.append(f"{run.path.name} has no {', '.join(missing)}.")
        holes = np.diff(run.time)
        if holes.max() > HOLE * period:
            notes.append(
                f"{run.path.name}: up to {holes.max():.2f} s are without samples; the missing ones "
                "were drawn as a straight line."
            )
        states = {
            name: values[:, column] if name in JOINTS else values
            for name, values in signals.items()
            if name in known or run.elements.get(name) == other.elements.get(name)
        }
        sides.append(states if method == "" else resample(run.time, states, period))
    sound = [name for name in sides[0] if name in real.states and name in sim.states]
    falls, ends = [], []
    for side, run in zip(sides, runs):
        end, fall = len(side["joint_pos"]), math.nan
        if end < FEWEST:
            raise UniconError(
                f"{run.path} has {end} samples at {1 / period:g} Hz; at least {FEWEST} tell "
                "something: give a higher --rate or a longer run"
            )
        if "projected_gravity" in run.states:
            fall = float(fall_time(side["projected_gravity"], period))
        if not (whole or math.isnan(fall)):
            # Afterwards every joint differs, and nobody learns why.
            name, upright = run.path.name, round(fall / period)
            note = f"What came after the fall in {name} was left out (--whole keeps it)."
            if upright < FEWEST:
                note = f"{name} begins with a fall; what follows was compared all the same."
            else:
                end = upright
            notes.append(note)
        falls.append(fall)
        ends.append(end)
    a, b = sides
    limit = None if max_shift is None else math.floor(max_shift / period)
    aligned = aligned_mse(a["joint_pos"][: ends[0]], b["joint_pos"][: ends[1]], limit)
    shift, count = int(aligned.shift), int(aligned.overlap)
    first_a, first_b = max(0, shift), max(0, -shift)
    return Together(
        joints,
        period,
        method or "both were sampled at one rate; nothing was resampled",
        aligned,
        {name: a[name][first_a : first_a + count] for name in sound},
        {name: b[name][first_b : first_b + count] for name in sound},
        a,
        b,
        (ends[0], ends[1]),
        (real.begins + first_a * period, sim.begins + first_b * period),
        (real.begins + falls[0], sim.begins + falls[1]),
        {**real.elements, **dict.fromkeys(JOINTS, joints)},
        notes,
    )


def _joints(real: Run, sim: Run, notes: list[str]) -> tuple[tuple[str, ...], list[list[int]]]:
    """Return the names of the common joints and their columns in both runs."""
    counts = [run.states["joint_pos"].shape[1] for run in (real, sim)]
    if not real.joints or not sim.joints:
        if counts[0] != counts[1]:
            raise UniconError(
                f"{real.path} has {counts[0]} joints, {sim.path} {counts[1]}, and not both name "
                "them: put joint_names into the .npz"
            )
        names = real.joints or sim.joints or tuple(f"joint {k}" for k in range(counts[0]))
        nameless = " and ".join(run.path.name for run in (real, sim) if not run.joints)
        notes.append(f"{nameless} names no joints: the same order was assumed in both.")
        return names, [list(range(counts[0]))] * 2
    common = tuple(name for name in real.joints if name in sim.joints)
    if not common:
        raise UniconError(
            f"no joint of {real.path} ({', '.join(real.joints[:3])}, …) is in {sim.path} "
            f"({', '.join(sim.joints[:3])}, …); give two runs of one robot"
        )
    for run in (real, sim):
        left = [name for name in run.joints if name not in common]
        notes += [f"Only {run.path.name} has {', '.join(left)}: left out."] if left else []
    return common, [[run.joints.index(name) for name in common] for run in (real, sim)]


LONGEST = 300_000
"""Samples that are compared: 10 minutes at 500 Hz; longer runs are thinned out evenly."""
SAME_RATE = 1e-3
"""Share by which two periods may differ and still be one: 1 ms a second."""
EVEN = 0.25
"""Periods by which a sample may be early or late and its run still be even."""
SMOOTHED = 1.5
"""Old periods in a new one from which on values are averaged."""


def common_period(real: Run, sim: Run, rate: float | None) -> tuple[float, str]:
    """Return the period in [s] at which two runs are compared, and how they come to it.

    Args:
        real: one run.
        sim: the other.
        rate: that was asked for in [Hz]; None for the slower one's.

    Returns:
        The method is in words; "" where both can stay as they are.
    """
    periods, even = zip(*(_own_period(run.time) for run in (real, sim)))
    period = 1.0 / rate if rate else max(periods)
    shortest = max(float(run.time[-1]) for run in (real, sim)) / LONGEST
    too_many = period < shortest
    period = max(period, shortest)
    if all(even) and all(abs(own - period) <= SAME_RATE * period for own in periods):
        return period, ""
    each, other, new = (f"{1.0 / own:.4g} Hz" for own in (*periods, period))
    text = (
        f"the real run ({each}) and the simulated one ({other}) were resampled to {new}, linearly"
    )
    names = ("the real", "the simulated")
    if smoothed := [name for name, own in zip(names, periods) if period > SMOOTHED * own]:
        text += f"; before that {' and '.join(smoothed)} one was averaged over each new period"
    if too_many:
        text += f"; at no higher rate, since {LONGEST:,} samples are compared at most"
    return period, text


def _own_period(time: Float64) -> tuple[float, bool]:
    """Return the period of a run's samples, and whether all stand where it puts them."""
    mean = float(time[-1]) / (len(time) - 1)
    if np.abs(time - mean * np.arange(len(time))).max() <= EVEN * mean:
        return mean, True
    steps = np.diff(time)
    return float(np.mean(steps[steps < 3.0 * np.median(steps)])), False  # holes are not a rate


def resample(time: Float64, states: dict[str, Float64], period: float) -> dict[str, Float64]:
    """Return the states at even times from the first sample on.

    Linear interpolation. Where the new period is longer than `SMOOTHED` of the old ones, each value
    is the mean of that line over one period around it: noise does not fold into what is left.

    Args:
        time: of the samples in [s], rising, shape (n,).
        states: name to values, shape (n, d).
        period: of the result in [s].
    """
    grid = time[0] + period * np.arange(int((time[-1] - time[0]) / period + 1e-6) + 1)

    def line(at: Float64, values: Float64) -> Float64:
        return np.stack([np.interp(at, time, column) for column in values.T], axis=1)

    if period <= SMOOTHED * float(np.median(np.diff(time))):
        return {name: line(grid, values) for name, values in states.items()}
    ends = np.clip(grid[:, None] + period / 2 * np.array([-1.0, 1.0]), time[0], time[-1])
    at = np.union1d(time, ends)
    places, steps, width = np.searchsorted(at, ends), np.diff(at)[:, None], np.diff(ends)
    result = {}
    for name, values in states.items():
        middle = values.mean(axis=0)
        curve = line(at, values - middle)
        area = np.zeros_like(curve)
        np.cumsum(0.5 * steps * (curve[1:] + curve[:-1]), axis=0, out=area[1:])
        result[name] = middle + (area[places[:, 1]] - area[places[:, 0]]) / width
    return result
