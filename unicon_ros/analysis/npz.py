"""A run out of an `.npz`: one of ours, of anybody's, or UniCon's with the keys of its recorder."""

from __future__ import annotations

import tokenize
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import UniconError
from unicon_core.gap.trajectories import Array
from unicon_ros.analysis.run import BASE, JOINTS, Run, Window, make_run
from unicon_ros.recording.import_npz import KEYS

__all__ = ["read_npz"]

NOT_SURE = ("base_lin_vel", "base_lin_acc", "velocity_command")
"""What UniCon has in a frame or an order that each of its robots chooses."""

NAMES = ("joint_names", "dof_names", "DOF_NAMES")
LARGEST = 8 << 30
"""Bytes of an unpacked file: an hour of 29 joints at 500 Hz has 2 GB."""

_WRONG = (
    ValueError, TypeError, LookupError, EOFError, OverflowError, AttributeError, SyntaxError,
    RuntimeError,  # of an archive that is encrypted, or packed in an unknown way
    tokenize.TokenError, zipfile.BadZipFile, zipfile.LargeZipFile, zlib.error,
)  # fmt: skip


def read_npz(path: Path, window: Window) -> Run:
    """Read a run.

    Keys are names of states, shape (n, d); `joint_names` names the joints; time is `stamp_ns` in
    [ns], or `dt` or `period` between two samples in [s]. Of UniCon's, `ts` are seconds, and rows
    behind `len` were never written.

    Raises:
        UniconError: it cannot be read, or lacks what a comparison needs.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
        if size > LARGEST:
            raise UniconError(
                f"{path} unpacks to {size >> 30} GiB; at most {LARGEST >> 30} are read"
            )
        with np.load(path, allow_pickle=False) as file:
            return _run(path, file, window)
    except OSError as error:
        raise UniconError(f"cannot read {path}: {error.strerror or error}") from error
    except MemoryError:
        raise UniconError(f"{path} does not fit into memory; cut it into pieces") from None
    except _WRONG as error:
        raise UniconError(f"{path} is not an .npz of numbers: {error}") from error


def _run(path: Path, file: Any, window: Window) -> Run:
    known = [name for name in (*JOINTS, *BASE) if name in file]
    found: dict[str, NDArray[Any]] = {name: file[name] for name in known}
    for key, name in KEYS.items():
        wanted = name in (*JOINTS, *BASE) and name not in (*found, *NOT_SURE)
        if key in file and wanted:
            found[name] = file[key][:, [3, 0, 1, 2]] if name == "base_quat" else file[key]
    if "states_rpy" in file and not {"projected_gravity", "base_quat"} & found.keys():
        found["projected_gravity"] = _gravity(file["states_rpy"])
    for name, values in found.items():
        if values.ndim != 2 or values.dtype.kind not in "fiu":
            raise UniconError(
                f"{path}: {name} has shape {values.shape} and type {values.dtype}; "
                "give numbers of shape (samples, elements)"
            )
    count = len(found["joint_pos"]) if "joint_pos" in found else 0
    if "len" in file and "ts" in file:  # the index of the last row that was written
        count = min(count, int(file["len"]) + 1)
        found = {name: values[:count] for name, values in found.items()}
    names = next((file[key] for key in NAMES if key in file), ())
    about = {name: str(file[name]) for name in ("robot", "workflow", "platform") if name in file}
    return make_run(path, about, _clocks(file, count), tuple(map(str, names)), found, window)


@np.errstate(invalid="ignore")  # of infinite times, which `rising` refuses
def _clocks(file: Any, count: int) -> list[tuple[str, Array]]:
    """Return what may tell the time, in [s]."""
    clocks: list[tuple[str, Array]] = []
    if "stamp_ns" in file:
        stamps = np.asarray(file["stamp_ns"]).reshape(-1)[:count]
        if stamps.dtype.kind in "iu":
            stamps = stamps.astype(np.int64)  # unsigned ones cannot go back
        if len(stamps) == count and stamps.dtype.kind in "if":
            clocks.append(("stamp_ns", np.asarray((stamps - stamps[:1]) * 1e-9, np.float64)))
    clocks += [
        (key, np.asarray(float(file[key]) * np.arange(count), np.float64))
        for key in ("dt", "period", "rec_dt")
        if key in file
    ]
    if "ts" in file:
        times = np.asarray(file["ts"]).reshape(-1)[:count]
        if len(times) == count and times.dtype.kind in "iuf":
            clocks.append(("ts", times.astype(np.float64)))
    return clocks


def _gravity(rpy: NDArray[Any]) -> Array:
    """Return the unit vector of gravity in the base frame of roll, pitch and yaw in [rad]."""
    if rpy.ndim != 2 or rpy.shape[1] != 3:
        raise ValueError(f"states_rpy has shape {rpy.shape}, not (samples, 3)")
    roll, pitch = rpy[:, 0].astype(np.float64), rpy[:, 1].astype(np.float64)
    return np.stack(
        [np.sin(pitch), -np.sin(roll) * np.cos(pitch), -np.cos(roll) * np.cos(pitch)], axis=1
    )
