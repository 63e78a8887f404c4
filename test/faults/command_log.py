"""Command log: what reached the motors and when, in a file that survives SIGKILL of its writer.

The file is mapped and shared: what was written is there when the process is not. All times are
those of `time.perf_counter_ns`, which processes of one host share (CLOCK_MONOTONIC).
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

OPEN, RECV, SEND, FAULT, CLOSE = 1, 2, 3, 4, 5
"""Kinds of rows: the platform was built, a tick began, a command left, the fault, it was closed."""

_CAPACITY = 8192
_BYTES = 8  # of every number in a row


def _row(joints: int) -> np.dtype[Any]:
    return np.dtype(
        [
            ("target", np.float64, (joints,)),  # [rad]
            ("speed", np.float64, (joints,)),  # velocity target in [rad/s]
            ("effort", np.float64, (joints,)),  # feed-forward in [N·m]
            ("stiffness", np.float64, (joints,)),  # [N·m/rad]
            ("damping", np.float64, (joints,)),  # [N·m·s/rad]
            ("time", np.int64),  # [ns]
            ("tick", np.int64),
            ("velocity", np.float64, 3),  # velocity_command in [m/s], [rad/s]
            ("kind", np.int64),  # last: a row without one is not whole
        ]
    )


_BARE = _row(0).itemsize // _BYTES  # numbers of a row beside the joints'
_EACH = 5  # of each joint


class CommandLog:
    """Rows of one process.

    Args:
        path: of the file.
        joints: make it, empty, for so many joints; else open what another made.

    Attributes:
        rows: all rows, also those that nobody has written yet (kind 0).
    """

    def __init__(self, path: Path, joints: int | None = None) -> None:
        mode: Any = "r+" if joints is None else "w+"
        if joints is None:  # the file's length tells
            joints = (path.stat().st_size // (_CAPACITY * _BYTES) - _BARE) // _EACH
        self.path = path
        self.rows = np.memmap(path, dtype=_row(joints), mode=mode, shape=(_CAPACITY,))
        self._next = 0

    def add(self, kind: int, tick: int = 0, **values: Any) -> None:
        """Add a row with the present time; a full log drops it."""
        while self._next < _CAPACITY and self.rows[self._next]["kind"]:
            self._next += 1  # of another writer of this process
        if self._next >= _CAPACITY:
            return
        row = self.rows[self._next]
        row["time"], row["tick"] = time.perf_counter_ns(), tick
        for name, value in values.items():
            row[name] = value
        row["kind"] = kind

    def of(self, kind: int) -> NDArray[Any]:
        """Return a copy of the rows of a kind, as they are at this moment."""
        return np.array(self.rows[self.rows["kind"] == kind])

    def driven(self, speed: float) -> int:
        """Return how many commands had this forward velocity command in [m/s]."""
        return int(np.count_nonzero(np.abs(self.of(SEND)["velocity"][:, 0] - speed) < 1e-3))
