"""Reads a run, from a record or from an `.npz`."""

from __future__ import annotations

import math
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import UniconError
from unicon_core.gap.trajectories import Array
from unicon_ros.analysis.run import BASE, JOINTS, Run, Window, make_run
from unicon_ros.recording import open_record
from unicon_ros.recording.npz import KEYS, NAMES, UNICONS, Archive, read_archive, too_large


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
    clocks: list[tuple[str, Array]] = []
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


def _seconds(stamps: NDArray[np.int64]) -> Array:
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
    found: dict[str, NDArray[Any]] = {n: arrays[n] for n in (*JOINTS, *BASE) if n in arrays}
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
def _clocks(archive: Archive, count: int) -> list[tuple[str, Array]]:
    """Return what may tell the time, in [s]."""
    clocks: list[tuple[str, Array]] = []
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
