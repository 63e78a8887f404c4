"""Run: what a file tells of one run, as arrays over time, for the comparison of two."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import UniconError
from unicon_core.gap.trajectories import Array

JOINTS = (
    "joint_pos",
    "joint_vel",
    "joint_effort",
    "joint_pos_target",
    "joint_vel_target",
    "joint_effort_ff",
    "joint_stiffness",
    "joint_damping",
    "motor_temperature",
)
"""The states of joints that are looked at; `joint_pos` must be there."""

BASE = {
    "projected_gravity": 3,
    "base_quat": 4,
    "base_ang_vel": 3,
    "base_lin_vel": 3,
    "base_lin_acc": 3,
    "velocity_command": 3,
}
"""The states of the base that are looked at, with their lengths. Its place in the world is none of
them: it is the sum of all differences before."""

FEWEST = 16
"""Samples of a run; of fewer nothing can be said."""
LARGEST = 1e9
"""Of a number: whatever a joint measures is far below."""


@dataclass(frozen=True)
class Run:
    """One run, sampled in time.

    Attributes:
        path: of the file.
        about: robot, workflow, platform, … as far as the file tells, to show.
        clock: what the times were taken from, in words.
        begins: time of the first sample in [s] since the file's first one.
        time: of each sample in [s] since then, rising, shape (n,).
        joints: names of the joints; empty where the file tells none.
        states: name to float64, shape (n, d).
        notes: what was left out or assumed, in sentences.
    """

    path: Path
    about: Mapping[str, str]
    clock: str
    begins: float
    time: Array
    joints: tuple[str, ...]
    states: Mapping[str, Array]
    notes: list[str] = field(default_factory=list)


Window = tuple[float, float]
"""From when to when, in [s] since the file's first sample."""


def make_run(
    path: Path,
    about: Mapping[str, str],
    clocks: list[tuple[str, Array]],
    joints: tuple[str, ...],
    found: Mapping[str, NDArray[Any]],
    window: Window,
) -> Run:
    """Check what was read and choose the clock.

    Args:
        path: of the file.
        about: what it tells of itself.
        clocks: name and time of each sample in [s], best first; the first that rises is taken.
        joints: their names, or empty.
        found: states by name, shape (n, d).
        window: what is wanted of it.

    Raises:
        UniconError: no joint positions, too few samples, no clock that rises, or joint positions
            that are not numbers.
    """
    _check_shapes(path, joints, found)
    count = len(found["joint_pos"])
    usable = ((name, time, rising(time)) for name, time in clocks)
    chosen = next(((name, time, kept) for name, time, kept in usable if kept is not None), None)
    if count < FEWEST:
        raise UniconError(f"{path} has {count} samples; at least {FEWEST} tell something")
    if chosen is None:
        raise UniconError(
            f"{path} has no clock that goes on, only {[name for name, _ in clocks]}; in an .npz, "
            "dt=0.02 says that samples are 20 ms apart"
        )
    clock, time, kept = chosen
    notes = []
    if not kept.all():
        notes.append(
            f"{path.name}: {int((~kept).sum())} of {count} samples had the time of the one before "
            "and were left out."
        )
    time = time - time[0]
    # A microsecond more: 0.5 s may be 0.49999999 in the file.
    kept = kept & (time >= window[0] - 1e-6) & (time <= window[1] + 1e-6)
    if kept.sum() < FEWEST:
        raise UniconError(
            f"{path} has {kept.sum()} samples from {window[0]:g} to {window[1]:g} s; it lasts "
            f"{time[-1]:.2f} s: choose --from and --to so that at least {FEWEST} are left"
        )
    rows: Any = kept
    inside = np.flatnonzero(kept)
    if inside[-1] - inside[0] + 1 == len(inside):  # a view, where an index would be a copy
        rows = slice(inside[0], inside[-1] + 1)
    time = time[rows]
    states = {}
    for name, values in found.items():
        array = np.asarray(values[rows], np.float64)
        if what := _not_numbers(name, array, time, joints):
            if name == "joint_pos":
                raise UniconError(
                    f"{path}: {what}; cut it there (--from, --to; --sim-from, --sim-to), or "
                    "fill it in"
                )
            notes.append(f"{path.name}: {what}; it was left out.")
        else:
            states[name] = array
    quat = states.pop("base_quat", None)
    if quat is not None and "projected_gravity" not in states:
        states["projected_gravity"] = _gravity(quat)
    begins = float(time[0])
    return Run(path, about, clock, begins, time - begins, joints, states, notes)


def _check_shapes(path: Path, joints: tuple[str, ...], found: Mapping[str, NDArray[Any]]) -> None:
    if "joint_pos" not in found:
        raise UniconError(
            f"{path} has no joint_pos; it has {', '.join(found) or 'nothing that is known'}"
        )
    count, width = found["joint_pos"].shape
    if joints and len(joints) != width:
        raise UniconError(f"{path} names {len(joints)} joints, its joint_pos has {width}")
    if len(set(joints)) < len(joints):
        raise UniconError(f"{path} names a joint twice: {', '.join(joints)}")
    for name, values in found.items():
        length = width if name in JOINTS else BASE[name]
        if values.shape != (count, length):
            raise UniconError(f"{path}: {name} has shape {values.shape}, not {(count, length)}")


def _not_numbers(name: str, values: Array, time: Array, joints: tuple[str, ...]) -> str:
    """Return what is wrong with a state, "" where all are numbers."""
    wrong = ~(np.abs(values) < LARGEST)
    if not wrong.any():
        return ""
    rows = np.flatnonzero(wrong.any(axis=1))
    element = int(np.argwhere(wrong)[0][1])
    who = joints[element] if joints and name in JOINTS else f"element {element}"
    return (
        f"{name} is {values[rows[0], element]} in {len(rows)} samples from {time[rows[0]]:.2f} to "
        f"{time[rows[-1]]:.2f} s, first in {who}"
    )


def _gravity(quat: Array) -> Array:
    """Return the unit vector of gravity in the base frame, shape (n, 3), of wxyz base to world."""
    w, x, y, z = (quat / np.maximum(np.linalg.norm(quat, axis=1, keepdims=True), 1e-9)).T
    return np.stack([2 * (w * y - x * z), -2 * (w * x + y * z), 2 * (x * x + y * y) - 1], axis=1)


@np.errstate(invalid="ignore")
def rising(time: Array) -> NDArray[np.bool_] | None:
    """Return which samples have a time of their own; None for what is not a clock.

    A clock never goes back, and moves in at least half of the samples.
    """
    steps = np.diff(time)
    if len(time) < 2 or not (steps >= 0.0).all() or (steps > 0.0).mean() < 0.5:
        return None
    return np.concatenate([[True], steps > 0.0])
