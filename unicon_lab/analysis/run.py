"""Run: what a file tells of one run, as arrays over time, for the comparison of two."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

import numpy as np

from unicon_base import UniconError
from unicon_base.arrays import Array, Bool, Float64
from unicon_core.platforms.kit.base import rotation
from unicon_core.states.standard import COMMAND_STATES, JOINT_STATES
from unicon_lab.recording import Record, open_record
from unicon_lab.recording.imported import KEYS, NAMES, UNICONS, Archive, read_archive, too_large

TRACKING = "tracking_error"
"""Target − position in [rad]."""
JOINTS = (*JOINT_STATES, *COMMAND_STATES, "motor_temperature", TRACKING)
"""The states of joints that are looked at; `joint_pos` must be there."""

_XYZ = ("x", "y", "z")
BASE = {
    "projected_gravity": _XYZ,
    "base_quat": ("w", *_XYZ),
    "base_ang_vel": _XYZ,
    "base_lin_vel": _XYZ,
    "base_lin_acc": _XYZ,
    "velocity_command": ("vx", "vy", "wz"),
}
"""The states of the base that are looked at, with their elements. Its place in the world is none of
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
        states: name to float64, shape (n, d); signals beside the states, and `figures_of` it.
        notes: what was left out or assumed, in sentences.
        broken: states in which something is not a number, with `LARGEST` in its place; likewise.
        elements: of each state and signal, names; empty of joints where the file tells none.
    """

    path: Path
    about: Mapping[str, str]
    clock: str
    begins: float
    time: Float64
    joints: tuple[str, ...]
    states: Mapping[str, Float64]
    notes: list[str] = field(default_factory=list)
    broken: Mapping[str, Float64] = field(default_factory=dict)
    elements: Elements = field(default_factory=dict)


Elements: TypeAlias = Mapping[str, tuple[str, ...]]
"""Name of a signal to the names of its elements, length d."""
Signals: TypeAlias = tuple[Mapping[str, Array], Elements]
"""Name to values, shape (n, d), and names of their elements."""

Window = tuple[float, float]
"""From when to when, in [s] since the file's first sample."""


def make_run(
    path: Path,
    about: Mapping[str, str],
    clocks: list[tuple[str, Float64]],
    joints: tuple[str, ...],
    found: Mapping[str, Array],
    window: Window,
    notes: list[str],
    more: Elements,
) -> Run:
    """Check what was read and choose the clock.

    Args:
        path: of the file.
        about: what it tells of itself.
        clocks: name and time of each sample in [s], best first; the first that rises is taken.
        joints: their names, or empty.
        found: states and other signals by name, shape (n, d).
        window: what is wanted of it.
        notes: what is known of it already.
        more: elements of what `found` has beside the states.

    Raises:
        UniconError: no joint positions, too few samples, no clock that rises, or joint positions
            that are not numbers.
    """
    elements = dict.fromkeys(JOINTS, joints) | BASE | dict(more)
    _check_shapes(path, elements, found)
    count = len(found["joint_pos"])
    if count < FEWEST:
        raise UniconError(f"{path} has {count} samples; at least {FEWEST} tell something")
    for clock, time in clocks:  # noqa: B007  (the first good one is used below)
        if (kept := rising(time)) is not None:
            break
    else:
        raise UniconError(
            f"{path} has no clock that goes on, only {[name for name, _ in clocks]}; in an .npz, "
            "dt=0.02 says that samples are 20 ms apart"
        )
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
    time = time[kept]
    states, broken = dict[str, Float64](), dict[str, Float64]()
    for name, values in found.items():
        states[name] = array = values[kept].astype(np.float64)
        rows, columns = np.nonzero(~(np.abs(array) < LARGEST))
        if not rows.size:
            continue
        first, last, column = rows[0], rows[-1], columns[0]
        names = elements[name]
        what = (
            f"{name} is {array[first, column]} in {len({*rows.tolist()})} samples from "
            f"{time[first]:.2f} to {time[last]:.2f} s, first in "
            f"{names[column] if names else f'element {column}'}"
        )
        if name == "joint_pos":
            raise UniconError(
                f"{path}: {what}; cut it there (--from, --to; --sim-from, --sim-to), or fill it in"
            )
        notes.append(f"{path.name}: {what}; it was left out.")
        broken[name] = np.clip(np.nan_to_num(states.pop(name), nan=LARGEST), -LARGEST, LARGEST)
    broken.pop("base_quat", None)
    quat = states.pop("base_quat", None)
    if quat is not None and "projected_gravity" not in states:
        length = np.maximum(np.linalg.norm(quat, axis=1, keepdims=True), 1e-9)
        states["projected_gravity"] = -rotation(quat / length)[:, 2]
    states |= figures_of(states)
    begins, time = float(time[0]), time - time[0]
    return Run(path, about, clock, begins, time, joints, states, notes, broken, elements)


def figures_of(states: Mapping[str, Float64]) -> dict[str, Float64]:
    """Return what follows from the states that there are, over time, shape (n, d).

    `tracking_error`; `velocity_error` and `turn_error`: base velocity minus command in [m/s], as a
    length, and in [rad/s]; `power`: Σ |torque · velocity| of the joints in [W].
    """
    figures, command = {}, states.get("velocity_command")
    if "joint_pos_target" in states:
        figures[TRACKING] = states["joint_pos_target"] - states["joint_pos"]
    if command is not None and "base_lin_vel" in states:
        off = (states["base_lin_vel"] - command)[:, :2]
        figures["velocity_error"] = np.linalg.norm(off, axis=1, keepdims=True)
    if command is not None and "base_ang_vel" in states:
        figures["turn_error"] = (states["base_ang_vel"] - command)[:, 2:]
    if {"joint_effort", "joint_vel"} <= states.keys():
        power = np.abs(states["joint_effort"] * states["joint_vel"])
        figures["power"] = power.sum(axis=1, keepdims=True)
    return figures


def _check_shapes(path: Path, elements: Elements, found: Mapping[str, Array]) -> None:
    if "joint_pos" not in found:
        raise UniconError(
            f"{path} has no joint_pos; it has {', '.join(found) or 'nothing that is known'}"
        )
    (count, width), joints = found["joint_pos"].shape, elements["joint_pos"]
    if joints and len(joints) != width:
        raise UniconError(f"{path} names {len(joints)} joints, its joint_pos has {width}")
    if len(set(joints)) < len(joints):
        raise UniconError(f"{path} names a joint twice: {', '.join(joints)}")
    for name, values in found.items():
        length = width if name in JOINTS else len(elements[name])
        if values.shape != (count, length):
            raise UniconError(f"{path}: {name} has shape {values.shape}, not {(count, length)}")


@np.errstate(invalid="ignore")
def rising(time: Float64) -> Bool | None:
    """Return which samples have a time of their own; None for what is not a clock.

    A clock never goes back, and moves in at least half of the samples.
    """
    steps = np.diff(time)
    if len(time) < 2 or not (steps >= 0.0).all() or (steps > 0.0).mean() < 0.5:
        return None
    return np.concatenate([[True], steps > 0.0])


def read_run(
    path: Path,
    window: Window = (0.0, math.inf),
    more: Callable[[Record, list[str]], Signals] = lambda record, notes: ({}, {}),
) -> Run:
    """Read a run from a record of ours or from an `.npz`.

    Args:
        path: of the file.
        window: what is wanted of it.
        more: tells further signals of a record, in every tick, and notes what is missing.

    Of a record every state is taken where its tick ended: what was measured and what was made of it
    go together there. A tick that a fault cut off is left out.

    Raises:
        UniconError: it cannot be read, is of many robots, or lacks what a comparison needs.
    """
    if path.exists() and not (path.is_file() or path.is_dir()):  # a pipe would never end
        raise UniconError(f"{path} is neither a file nor a folder; give a recording")
    if path.suffix.lower() == ".npz":
        return read_npz(path, window)
    record = open_record(path)
    layout = record.layout
    if layout.num_robots is not None:
        raise UniconError(
            f"{path} is of {layout.num_robots} robots at once; record one of them on its own"
        )
    whole, notes = record.ended, list[str]()
    found, elements = more(record, notes)
    names = [name for name in (*BASE, *JOINTS) if name in layout.slots]
    found = {name: record.states(name) for name in names} | dict(found)
    found = {name: values[whole] for name, values in found.items()}
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
    return make_run(path, about, clocks, record.joints, found, window, notes, elements)


def _seconds(stamps: Array) -> Float64:
    """Return times in [s] from the first one; a clock of nanoseconds since 1970 loses no digit."""
    return (stamps - stamps[:1]) * 1e-9


NOT_SURE = ("base_lin_vel", "base_lin_acc", "velocity_command", "base_quat", "base_pos_w")
"""What UniCon has in a frame or an order that each of its robots chooses, or is not looked at."""

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
    arrays = archive.arrays
    known = {key: name for key, name in KEYS.items() if name not in NOT_SURE}
    known |= {name: name for name in (*JOINTS, *BASE)}
    found = {name: archive.columns(key) for key, name in known.items() if key in arrays}
    quat = None if {"projected_gravity", "base_quat"} & found.keys() else archive.base_quat()
    if quat is not None:
        found["base_quat"] = quat
    rows = len(found["joint_pos"]) if "joint_pos" in found else 0
    count = archive.written(rows)
    found = {name: values[:count] if count < rows else values for name, values in found.items()}
    about = {name: str(arrays[name]) for name in ABOUT if name in arrays}
    clocks, joints = _clocks(archive, count), archive.joint_names()
    try:
        return make_run(path, about, clocks, joints, found, window, [], {})
    except MemoryError:
        raise too_large(path) from None


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
            clocks.append(("stamp_ns", _seconds(stamps)))
    for key in STEPS:
        step = archive.number(key)
        if step is not None:
            clocks.append((key, np.asarray(step * np.arange(count), np.float64)))
    times = archive.times(count)
    if times is not None:
        clocks.append(("ts", times))
    return clocks
