"""Reads a run, from a record or from an `.npz`."""

from __future__ import annotations

import math
from pathlib import Path

from unicon_core.errors import UniconError
from unicon_ros.analysis.npz import read_npz
from unicon_ros.analysis.record import read_record
from unicon_ros.analysis.run import Run, Window


def read_run(path: Path, window: Window = (0.0, math.inf)) -> Run:
    """Read a run from a record of ours or from an `.npz`.

    Raises:
        UniconError: it cannot be read, or does not hold what a comparison needs.
    """
    if path.exists() and not (path.is_file() or path.is_dir()):  # a pipe would never end
        raise UniconError(f"{path} is neither a file nor a folder; give a recording")
    if path.suffix.lower() == ".npz":
        return read_npz(path, window)
    return read_record(path, window)
