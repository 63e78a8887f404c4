"""Reads a run, from a record or from an `.npz`."""

from __future__ import annotations

import math
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import UniconError
from unicon_core.gap.trajectories import Array
from unicon_ros.analysis.npz import read_npz
from unicon_ros.analysis.run import BASE, JOINTS, Run, Window, make_run
from unicon_ros.recording import open_record


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
