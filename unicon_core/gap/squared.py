"""Mean squared errors, sample by sample: for rollouts that repeat, whose clocks agree."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from unicon_core.errors import UniconError
from unicon_core.gap.trajectories import Array, two

_AXES = {"all": (-2, -1), "element": (-2,), "frame": (-1,)}


def mse(real: ArrayLike, sim: ArrayLike, per: str = "all") -> Array:
    """Return the mean of (real − sim)², in the elements' unit².

    The aligned MSE sums over elements and takes both directions: where the best shift is 0, it is
    2·d times `mse` over all.

    Args:
        real: shape (…, n, d).
        sim: of as many samples; leading axes are broadcast.
        per: `all`: one value, shape (…,); `element`: (…, d); `frame`: one a sample, (…, n).

    Raises:
        UniconError: something that is not a number, empty, or shapes that do not fit.
    """
    if per not in _AXES:
        raise UniconError(f"gap: per is {per!r}; give one of {', '.join(_AXES)}")
    a, b = two(real, sim, same_length=True)
    means: Array = np.mean((a - b) ** 2, axis=_AXES[per])
    return means


def rmse(real: ArrayLike, sim: ArrayLike, per: str = "all") -> Array:
    """Return the root of `mse`, in the elements' unit; the same arguments, shapes and errors."""
    root: Array = np.sqrt(mse(real, sim, per))
    return root
