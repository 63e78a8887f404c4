"""What numbers of a type can hold, for codecs."""

from __future__ import annotations

from typing import Any

import numpy as np

SINGLE_MAX = float(np.finfo(np.float32).max)
DOUBLE_MAX = float(np.finfo(np.float64).max)


def limits(dtype: np.dtype[Any] | str) -> tuple[int, int]:
    """Return the smallest and largest integer of a dtype."""
    info = np.iinfo(dtype)
    return int(info.min), int(info.max)
