"""Run: what a file tells of one run, as arrays over time, for the comparison of two."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base.arrays import Array, Bool, Float64, Int64
from unicon_base.errors import UniconError
from unicon_lab.recording import open_record
from unicon_lab.recording.imported import KEYS, NAMES, UNICONS, Archive, read_archive, too_large

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
    time: Float64
    joints: tuple[str, ...]
    states: Mapping[str, Float64]
    notes: list[str] = field(default_factory=list)


Window = tuple[float, float]
"""From when to when, in [s] since the file's first sample."""


def make_run(
    path: Path,
    about: Mapping[str, str],
    clocks: list[tuple[str, Float64]],
    joints: tuple[str, ...],
    found: Mapping[str, Array],
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


def _check_shapes(path: Path, joints: tuple[str, ...], found: Mapping[str, Array]) -> None:
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


def _not_numbers(name: str, values: Float64, time: Float64, joints: tuple[str, ...]) -> str:
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


def _gravity(quat: Float64) -> Float64:
    """Return the unit vector of gravity in the base frame, shape (n, 3), of wxyz base to world."""
    w, x, y, z = (quat / np.maximum(np.linalg.norm(quat, axis=1, keepdims=True), 1e-9)).T
    return np.stack([2 * (w * y - x * z), -2 * (w * x + y * z), 2 * (x * x + y * y) - 1], axis=1)


@np.errstate(invalid="ignore")
def rising(time: Float64) -> Bool | None:
    """Return which samples have a time of their own; None for what is not a clock.

    A clock never goes back, and moves in at least half of the samples.
    """
    steps = np.diff(time)
    if len(time) < 2 or not (steps >= 0.0).all() or (steps > 0.0).mean() < 0.5:
        return None
    return np.concatenate([[True], steps > 0.0])


def read_run(path: Path, window: Window = (0.0, math.inf)) -> Run:
    """Read a run from a record of ours or from an `.npz`.

    Raises:
        UniconError: it cannot be read, or does not hold what a comparison needs.
    """
    if path.exists() and not (path.is_file() or path.is_dir()):  # a pipe would never end
        raise UniconError(f"{path} is neither a file nor a folder; give a recording")
    if path.suffix.lower() == ".npz":
        return read_npz(path, window)
    return _read_record(path, window)


def _read_record(path: Path, window: Window) -> Run:
    """Read a recording or the record of a fault.

    Every state is taken where its tick ended: what was measured and what was made of it go
    together there. A tick that a fault cut off is left out.

    Raises:
        UniconError: it cannot be read, is of many robots, or lacks what a comparison needs.
    """
    record = open_record(path)
    layout = record.layout
    if layout.num_robots is not None:
        raise UniconError(
            f"{path} is of {layout.num_robots} robots at once; record one of them on its own"
        )
    whole = record.ended
    states = {name: record.states(name)[whole] for name in (*JOINTS, *BASE) if name in layout.slots}
    states = {name: values for name, values in states.items() if values.ndim == 2}
    clocks: list[tuple[str, Float64]] = []
    if "stamp_ns" in layout.slots:
        stamps = record.states("stamp_ns")[whole].reshape(-1)
        clocks.append(("the robot's own time, stamp_ns", _seconds(stamps)))
    clocks.append(("the times of the ticks", _seconds(record.stamps[whole])))
    with suppress(UniconError):  # it does not say its period
        numbers = record.period * (record.ticks[whole] - record.ticks[:1])
        clocks.append(("the numbers of the ticks", np.asarray(numbers, np.float64)))
    facts = ("robot", "workflow", "platform", "reason", "written")
    about = {name: record.facts[name] for name in facts if record.facts.get(name)}
    joints = layout.specs["joint_pos"].names if "joint_pos" in layout.specs else ()
    return make_run(path, about, clocks, tuple(joints), states, window)


def _seconds(stamps: Int64) -> Float64:
    """Return times in [s] from the first one; a clock of nanoseconds since 1970 loses no digit."""
    return np.asarray((stamps - stamps[:1]) * 1e-9, np.float64)


NOT_SURE = ("base_lin_vel", "base_lin_acc", "velocity_command")
"""What UniCon has in a frame or an order that each of its robots chooses."""

ABOUT = ("robot", "workflow", "platform")
STEPS = ("dt", "period", "rec_dt")
"""Keys of the time between two samples in [s]."""


def read_npz(path: Path, window: Window) -> Run:
    """Read a run.

    Keys are names of states, shape (n, d); `joint_names` names the joints; time is `stamp_ns` in
    [ns], or `dt` or `period` between two samples in [s]. Of UniCon's, `ts` are seconds, and rows
    behind `len` were never written.

    Raises:
        UniconError: it cannot be read, or lacks what a comparison needs.
    """
    wanted = (*JOINTS, *BASE, *KEYS, *UNICONS, *NAMES, *ABOUT, *STEPS, "stamp_ns")
    archive = read_archive(path, wanted)
    try:
        return _run(archive, window)
    except MemoryError:
        raise too_large(path) from None


def _run(archive: Archive, window: Window) -> Run:
    path, arrays = archive.path, archive.arrays
    found: dict[str, Array] = {n: arrays[n] for n in (*JOINTS, *BASE) if n in arrays}
    for key, name in KEYS.items():
        wanted = name in JOINTS or (name in BASE and name not in (*NOT_SURE, "base_quat"))
        if key in arrays and wanted and name not in found:
            found[name] = arrays[key]
    quat = None if {"projected_gravity", "base_quat"} & found.keys() else archive.base_quat()
    if quat is not None:
        found["base_quat"] = quat
    for name, values in found.items():
        if values.ndim != 2 or values.dtype.kind not in "fiu":
            raise UniconError(
                f"{path}: {name} has shape {values.shape} and type {values.dtype}; "
                "give numbers of shape (samples, elements)"
            )
    rows = len(found["joint_pos"]) if "joint_pos" in found else 0
    count = archive.written(rows)
    if count < rows:
        found = {name: values[:count] for name, values in found.items()}
    about = {name: str(arrays[name]) for name in ABOUT if name in arrays}
    return make_run(path, about, _clocks(archive, count), archive.joint_names(), found, window)


@np.errstate(invalid="ignore")  # of infinite times, which `rising` refuses
def _clocks(archive: Archive, count: int) -> list[tuple[str, Float64]]:
    """Return what may tell the time, in [s]."""
    clocks: list[tuple[str, Float64]] = []
    stamps = archive.arrays.get("stamp_ns")
    if stamps is not None:
        stamps = stamps.reshape(-1)[:count]
        if stamps.dtype.kind in "iu":
            stamps = stamps.astype(np.int64)  # unsigned ones cannot go back
        if len(stamps) == count and stamps.dtype.kind in "if":
            clocks.append(("stamp_ns", np.asarray((stamps - stamps[:1]) * 1e-9, np.float64)))
    for key in STEPS:
        step = archive.number(key)
        if step is not None:
            clocks.append((key, np.asarray(step * np.arange(count), np.float64)))
    times = archive.times(count)
    if times is not None:
        clocks.append(("ts", times))
    return clocks
