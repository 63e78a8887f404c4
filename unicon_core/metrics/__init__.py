"""Reality gap: how far a simulated trajectory is from the real one; metrics on arrays alone.

A trajectory has the axes (n, d): n samples in time at one rate, d elements such as joints. More
axes may stand in front, (b, n, d); then so does the result's. Records are read, brought to
one rate and cut first (`unicon analyze`).
"""

from unicon_core.metrics.alignment import Aligned, aligned_mse, shift_losses
from unicon_core.metrics.distances import (
    chamfer,
    compare,
    fall_time,
    load,
    mse,
    rmse,
    spectral_distance,
    unfolded_mse,
    warming,
    wasserstein,
)
from unicon_core.metrics.elements import affine, match_elements

__all__ = [
    "Aligned",
    "affine",
    "aligned_mse",
    "chamfer",
    "compare",
    "fall_time",
    "load",
    "match_elements",
    "mse",
    "rmse",
    "shift_losses",
    "spectral_distance",
    "unfolded_mse",
    "warming",
    "wasserstein",
]
