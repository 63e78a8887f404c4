"""Mean squared errors: sample by sample, for rollouts whose clocks agree, and the unfolded MSE.

The unfolded MSE is the loss of the UniCon paper, as its authors' code computes it:

`unfolded_mse_loss` of `unicon/losses.py` in https://github.com/CreeperLin/unicon (commit 5c648bf),
with its defaults: a window of half of the samples is slid over one trajectory and held against the
beginning of the other one. The smallest mean of squares over all places of the window counts, in
both directions by half:

    L = ½ min_p mean (T̂[p : p+w] − T[: w])² + ½ min_p mean (T[p : p+w] − T̂[: w])²,  w = ⌊m/2⌋

Means are over samples and elements. Places begin at 0 and are sought in each direction by itself.
A copy that is late by up to half of the samples costs nothing in one direction; in the other one it
costs what its beginning lacks, unless the movement repeats.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from unicon_core.errors import UniconError
from unicon_core.gap.alignment import smallest_means
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


def unfolded_mse(real: ArrayLike, sim: ArrayLike) -> Array:
    """Return the unfolded MSE in the elements' unit², shape (…,).

    O(n log n) for each trajectory.

    Args:
        real: T, shape (…, n, d).
        sim: T̂, shape (…, m, d), whose half is the window; leading axes are broadcast.

    Raises:
        UniconError: something that is not a number, empty, shapes that do not fit, or no window.
    """
    a, b = two(real, sim)
    window = b.shape[-2] // 2
    if not 1 <= window <= a.shape[-2]:
        raise UniconError(
            f"gap: real has {a.shape[-2]} samples, sim {b.shape[-2]}; sim must have at least 2, "
            "and real half as many as sim"
        )
    losses = np.zeros(a.shape[:-2])
    for slid, held in ((a, b), (b, a)):
        shifts = np.arange(slid.shape[-2] - window + 1)
        pairs = np.full(len(shifts), window)
        losses += smallest_means(slid, held[..., :window, :], shifts, pairs)[0]
    losses /= 2.0 * a.shape[-1]
    return losses
