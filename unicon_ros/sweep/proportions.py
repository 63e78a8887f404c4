"""Proportions: how sure a share of rollouts is."""

from __future__ import annotations

import math

Z95 = 1.959963984540054
"""Of the normal distribution, for 95 %."""


def wilson(hits: int, count: int) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a share (Wilson 1927); (0, 1) of nothing.

    (p + z²/2n ± z √(p(1-p)/n + z²/4n²)) / (1 + z²/n); right for few hits too, where p ± z σ is not.

    Args:
        hits: how often it happened.
        count: of how many.
    """
    if not count:
        return 0.0, 1.0
    p, z = hits / count, Z95
    middle = p + z * z / (2 * count)
    half = z * math.sqrt(p * (1 - p) / count + z * z / (4 * count * count))
    whole = 1 + z * z / count
    low = 0.0 if not hits else (middle - half) / whole
    return low, 1.0 if hits == count else (middle + half) / whole
