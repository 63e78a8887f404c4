"""An `.npz` from anybody, within bounds: arrays, names and times; for the import and for analysis.

UniCon's recorder (`--rec`) writes `states_q`, `states_qd`, … of shape (frames, …), with `ts` [s],
`rec_dt` [s] and `DOF_NAMES`; quaternions are xyzw. https://github.com/CreeperLin/unicon
"""

from __future__ import annotations

import math
import zipfile
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import UniconError, one_line
from unicon_core.platforms.kit.base import quat_of_rpy

Array = NDArray[np.float64]

KEYS = {
    "states_q": "joint_pos",
    "states_qd": "joint_vel",
    "states_q_tau": "joint_effort",
    "states_q_ctrl": "joint_pos_target",
    "states_tau_ctrl": "joint_effort_ff",
    "states_q_temp": "motor_temperature",
    "states_quat": "base_quat",
    "states_ang_vel": "base_ang_vel",
    "states_lin_acc": "base_lin_acc",
    "states_lin_vel": "base_lin_vel",
    "states_pos": "base_pos_w",
    "states_cmd": "velocity_command",
}
"""Key of UniCon to our state. `states_rpy` counts where there is no quaternion."""

NAMES = ("joint_names", "dof_names", "DOF_NAMES")
"""Keys under which files name their joints, the first that is there."""

UNICONS = ("states_rpy", "ts", "rec_dt", "len")
"""What UniCon writes besides."""

LARGEST = 8 << 30
"""Bytes of an unpacked file: an hour of 29 joints at 500 Hz has 2 GB."""


@dataclass(frozen=True, eq=False)
class Archive:
    """What was read of a file.

    Attributes:
        path: of the file.
        keys: of everything in it.
        arrays: what was asked for and is there.
    """

    path: Path
    keys: tuple[str, ...]
    arrays: dict[str, NDArray[Any]]

    def joint_names(self) -> tuple[str, ...]:
        """Return the names of the joints in the file's order, empty where it has none."""
        found = next((self.arrays[key] for key in NAMES if key in self.arrays), ())
        return tuple(str(name) for name in np.ravel(np.asarray(found)))

    def written(self, rows: int) -> int:
        """Return how many of the rows were written: UniCon makes more, and `len` is the last one.

        Raises:
            UniconError: `len` is not a whole number.
        """
        if not {"ts", *KEYS} & set(self.keys):  # somebody else's `len` may be anything
            return rows
        last = self.number("len")
        if last is None:
            return rows
        if not math.isfinite(last) or last != int(last):
            raise UniconError(f"{self.path}: len is {last:g}, not the number of the last row")
        return min(rows, max(int(last) + 1, 0))

    def number(self, key: str) -> float | None:
        """Return a single number, None where there is none.

        Raises:
            UniconError: it is something else.
        """
        value = self.arrays.get(key)
        if value is None:
            return None
        if value.size != 1 or value.dtype.kind not in "fiu":
            raise UniconError(
                f"{self.path}: {key} is {value.dtype} of shape {value.shape}; give one number"
            )
        return float(value.reshape(-1)[0])

    def times(self, rows: int) -> Array | None:
        """Return `ts` of the first rows in [s], None where it does not tell their time."""
        times = self.arrays.get("ts")
        if times is None or times.dtype.kind not in "iuf":
            return None
        times = times.reshape(-1)[:rows]
        return times.astype(np.float64) if len(times) == rows else None

    def base_quat(self) -> NDArray[Any] | None:
        """Return UniCon's orientation as wxyz, base to world, shape (frames, 4); None without.

        Raises:
            UniconError: it has too few columns, or not numbers.
        """
        if "states_quat" in self.arrays:
            return self._columns("states_quat", 4)[:, [3, 0, 1, 2]]
        if "states_rpy" in self.arrays:
            return quat_of_rpy(self._columns("states_rpy", 3))
        return None

    def _columns(self, key: str, count: int) -> NDArray[Any]:
        values = self.arrays[key]
        if values.ndim != 2 or values.shape[1] < count or values.dtype.kind not in "fiu":
            raise UniconError(
                f"{self.path}: {key} has shape {values.shape} and type {values.dtype}; give "
                f"numbers of shape (frames, {count})"
            )
        return values[:, :count]


def read_archive(path: Path, wanted: Collection[str], plain: Collection[str] = ()) -> Archive:
    """Read arrays of a file; nothing is ever unpickled.

    Args:
        path: the file.
        wanted: keys that are read; objects among them are refused.
        plain: keys that are read where they are not objects, and left out where they are.

    Raises:
        UniconError: it cannot be read, unpacks to too much, or is not such a file.
    """
    if path.exists() and not path.is_file():  # a pipe would never end
        raise UniconError(f"{path} is not a file; give an .npz")
    arrays: dict[str, NDArray[Any]] = {}
    try:
        with zipfile.ZipFile(path) as packed:
            size = sum(entry.file_size for entry in packed.infolist())
        if size > LARGEST:
            raise UniconError(
                f"{path} unpacks to {size >> 30} GiB; at most {LARGEST >> 30} are read"
            )
        with np.load(path, allow_pickle=False) as file:
            keys = tuple(file.files)
            for key in keys:
                if key not in wanted and key not in plain:
                    continue
                try:
                    values = file[key]
                except ValueError:  # an object
                    if key in wanted:
                        raise
                    continue
                if not isinstance(values, np.ndarray):
                    raise ValueError(f"{key} is not an array")
                arrays[key] = values
    except UniconError:
        raise
    except OSError as error:
        raise UniconError(f"cannot read {path}: {error.strerror or error}") from error
    except MemoryError:
        raise too_large(path) from None
    except Exception as error:  # whatever zip files and headers of arrays raise
        # What NumPy adds, nobody is to do.
        reason = one_line(error)[:300].partition(". If you trust")[0]
        raise UniconError(
            f"{path} is not an .npz of arrays: {reason}; give one of numpy.savez, or of UniCon"
        ) from error
    return Archive(path, keys, arrays)


def too_large(path: Path) -> UniconError:
    """Return the error for a file that memory does not hold."""
    return UniconError(f"{path} does not fit into memory; cut it into pieces")
