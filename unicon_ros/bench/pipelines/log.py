"""What every pipeline shares: arguments, time stamps of wall-clock time, and logs without I/O.

All processes run on one host, whose clock they share: a message carries the time when its
state was made, and its receiver subtracts.
"""

from __future__ import annotations

import argparse
import os
import signal
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from unicon_base import AnyDict

CAPACITY = 200_000
"""Rows of a log; later ones are dropped."""

STATE, IMU, COMMAND, MIRROR = "joint_states", "imu/data", "joint_command", "mirror"


def arguments() -> argparse.Namespace:
    """Return the command line of a pipeline."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--rate", type=float, default=50.0, help="commands per second")
    parser.add_argument("--state-rate", type=float, default=500.0)
    parser.add_argument("--joints", type=int, default=20)
    parser.add_argument("--best-effort", action="store_true")
    parser.add_argument("--variant", default="")
    parser.add_argument("--out", type=Path, required=True, help="log file, .npz")
    return parser.parse_args()


def beside(log: Path, what: str) -> Path:
    """Return the file of another log of the same pipeline."""
    return log.with_name(f"{log.stem}_{what}.npz")


def set_stamp(stamp: Any, time_ns: int) -> None:
    """Write a time in [ns] into a builtin_interfaces/Time."""
    stamp.sec, stamp.nanosec = divmod(time_ns, 1_000_000_000)


def nanoseconds(stamp: Any) -> int:
    """Return a builtin_interfaces/Time in [ns]."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def joint_names(joints: int) -> list[str]:
    """Return the names of a benchmark's joints."""
    return [f"joint_{i}" for i in range(joints)]


class Log:
    """Rows of int64 in preallocated memory, written to a file at the end.

    Args:
        path: of the file; beside it one with the suffix `.ready` appears with the first row.
        columns: their names.
    """

    def __init__(self, path: Path, *columns: str) -> None:
        self.path = path
        self.columns = columns
        self.rows = np.zeros((CAPACITY, len(columns)), np.int64)
        self.count = 0

    def add(self, *values: int) -> None:
        """Add a row."""
        if not self.count:
            self.path.with_suffix(".ready").touch()
        if self.count < len(self.rows):
            self.rows[self.count] = values
            self.count += 1

    def save(self) -> None:
        """Write the columns; the file appears whole."""
        partial = self.path.with_suffix(".partial.npz")
        rows = self.rows[: self.count]
        values: AnyDict = {name: rows[:, i] for i, name in enumerate(self.columns)}
        np.savez(partial, **values)
        os.replace(partial, self.path)


class Stop:
    """Turns true at SIGTERM or SIGINT, so that a pipeline can save its log."""

    def __init__(self) -> None:
        self.asked = False
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._ask)

    def _ask(self, number: int, frame: FrameType | None) -> None:
        self.asked = True

    def __bool__(self) -> bool:
        return self.asked
