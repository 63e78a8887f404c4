"""Trajectories: the one check that every metric makes of what it is given."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from unicon_base.arrays import Float64
from unicon_base.errors import UniconError

LARGEST = 1e100
"""Of an element: its square, summed over any recording, is still a number."""


def one(values: ArrayLike, name: str) -> Float64:
    """Return a trajectory as float64, shape (…, n, d).

    Args:
        values: of numbers, shape (…, n, d).
        name: that an error calls it.

    Raises:
        UniconError: it lacks an axis, is empty, or has something in it that is not a number.
    """
    try:
        array = np.asarray(values, np.float64)
    except (TypeError, ValueError):
        raise UniconError(f"gap: {name} has something else than numbers in it") from None
    if array.ndim < 2:
        raise UniconError(
            f"gap: {name} has shape {array.shape}, not (…, samples, elements); "
            "one element over time is values[:, None]"
        )
    if 0 in array.shape:
        raise UniconError(f"gap: {name} is empty, shape {array.shape}; give at least one sample")
    # One pass for all that is well: NaN compares as False.
    if not (np.max(np.abs(array)) < LARGEST):
        bad = tuple(int(i) for i in np.argwhere(~(np.abs(array) < LARGEST))[0])
        of = f" of trajectory {bad[:-2] if len(bad) > 3 else bad[0]}" if len(bad) > 2 else ""
        raise UniconError(
            f"gap: {name} is {array[bad]} in sample {bad[-2]}, element {bad[-1]}"
            f"{of}; leave such samples out, or fill them in"
        )
    return array


def two(real: ArrayLike, sim: ArrayLike, same_length: bool = False) -> tuple[Float64, Float64]:
    """Return both trajectories as float64; their leading axes are broadcast.

    Args:
        real: shape (…, n, d).
        sim: shape (…, m, d).
        same_length: whether m must be n.

    Raises:
        UniconError: one of them is wrong, or they do not fit each other.
    """
    a, b = one(real, "real"), one(sim, "sim")
    if a.shape[-1] != b.shape[-1]:
        raise UniconError(
            f"gap: real has {a.shape[-1]} elements, sim {b.shape[-1]}; choose those in common"
        )
    if same_length and a.shape[-2] != b.shape[-2]:
        raise UniconError(
            f"gap: real has {a.shape[-2]} samples, sim {b.shape[-2]}; "
            "cut them to one length, or shift them with aligned_mse"
        )
    try:
        front = np.broadcast_shapes(a.shape[:-2], b.shape[:-2])
    except ValueError:
        raise UniconError(
            f"gap: real has shape {a.shape}, sim {b.shape}; "
            "the axes before (samples, elements) must be alike"
        ) from None
    return (
        np.broadcast_to(a, (*front, *a.shape[-2:])),
        np.broadcast_to(b, (*front, *b.shape[-2:])),
    )


def refuse_period(period: float) -> None:
    """Refuse a time between two samples that is none.

    Raises:
        UniconError: it is not > 0, or has no end.
    """
    if not 0.0 < period < math.inf:
        raise UniconError(f"gap: period is {period}; give a time > 0 in [s]")
