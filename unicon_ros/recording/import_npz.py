"""Import of UniCon's own recordings (`--rec` with an .npz): a record of ticks, for `unicon bag`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import UniconError, alternatives
from unicon_core.robots import Robot
from unicon_ros.recording.imported import write_imported
from unicon_ros.recording.npz import KEYS, NAMES, UNICONS, Archive, read_archive
from unicon_ros.recording.read import LONGEST, SHORTEST


def import_npz(
    source: Path,
    out: Path,
    robot: Robot,
    joints: Sequence[str] = (),
    rate: float | None = None,
) -> int:
    """Write a record of ticks; return how many.

    Args:
        source: the .npz file.
        out: of the record.
        robot: whose joints they are.
        joints: names in the file's order; those in the file unless told.
        rate: frames per second in [Hz]; by `rec_dt`, else `ts`, unless told.

    Raises:
        UniconError: it is not such a file, or does not fit the robot.
    """
    archive = read_archive(source, KEYS, (*NAMES, *UNICONS))
    arrays = {key: values for key, values in archive.arrays.items() if key in KEYS}
    if not arrays:
        raise UniconError(
            f"{source} has no key of UniCon; known: {', '.join(KEYS)}; it has: "
            f"{', '.join(sorted(archive.keys)) or 'none'}"
        )
    quat = archive.base_quat()
    lengths = {len(v) for v in (*arrays.values(), *(() if quat is None else (quat,))) if v.ndim}
    if len(lengths) != 1 or any(values.ndim != 2 for values in arrays.values()):
        shapes = ", ".join(f"{key} {v.shape}" for key, v in archive.arrays.items() if v.ndim)
        raise UniconError(f"{source}: arrays are (frames, elements) of one length; it has {shapes}")
    frames = archive.written(*lengths)
    names = tuple(joints) or archive.joint_names()
    states = {}
    for key, values in arrays.items():
        state = KEYS[key]
        if state.startswith(("joint_", "motor_")):
            states[state] = _fitting(source, state, _ordered(source, values, names, robot))
        elif state != "base_quat":
            states[state] = _fitting(source, state, values, 3)
    if quat is not None:
        states["base_quat"] = _fitting(source, "base_quat", quat)
    states = {name: values[:frames] for name, values in states.items()}
    return write_imported(out, source, robot, _stamps(archive, frames, rate), states)


def _ordered(
    source: Path, values: NDArray[Any], names: Sequence[str], robot: Robot
) -> NDArray[Any]:
    """Return columns in the robot's order of joints, aligned by name."""
    if not names:
        raise UniconError(
            f"{source} does not say the order of its {values.shape[1]} joints (DOF_NAMES); give "
            f"--joints with their names; robot {robot.name} has {', '.join(robot.joint_names)}"
        )
    if len(names) != values.shape[1]:
        raise UniconError(f"{source} has {values.shape[1]} joints, and {len(names)} names for them")
    for name in robot.joint_names:
        if name not in names:
            raise UniconError(
                f"{source} has no joint {name!r} of robot {robot.name}; {alternatives(name, names)}"
            )
    return values[:, [list(names).index(name) for name in robot.joint_names]]


def _fitting(
    source: Path, state: str, values: NDArray[Any], wanted: int | None = None
) -> NDArray[np.float32]:
    """Return the first columns of a state of the base, all of others."""
    if values.shape[1] < (wanted or 0):
        raise UniconError(
            f"{source}: {state} has shape {values.shape}; (frames, {wanted}) is wanted"
        )
    if values.dtype.kind not in "fiu":
        raise UniconError(f"{source}: {state} is {values.dtype}; numbers are wanted")
    return np.ascontiguousarray(values[:, :wanted], np.float32)


def _stamps(archive: Archive, frames: int, rate: float | None) -> NDArray[np.int64]:
    """Return the time of each frame in [ns] from 0: float32 seconds of `ts` are too coarse."""
    source = archive.path
    period = archive.number("rec_dt") if rate is None else 1.0 / rate
    if period is None:
        times = archive.times(frames)
        if times is None:
            raise UniconError(f"{source} has neither rec_dt nor ts; give --rate HZ")
        with np.errstate(invalid="ignore"):  # of infinite ones
            told = np.round((times - times[:1]) * 1e9)
        if not np.isfinite(told).all() or (np.diff(told) <= 0).any() or (told > 2.0**62).any():
            raise UniconError(f"{source}: ts does not grow with every frame; give --rate HZ")
        return told.astype(np.int64)
    if not SHORTEST <= period <= LONGEST:
        raise UniconError(f"{source}: rec_dt is {period:g} s; give --rate HZ")
    return np.round(np.arange(frames) * period * 1e9).astype(np.int64)
