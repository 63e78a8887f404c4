"""Speed: of joints whose robot tells angles alone, for wires of hands."""

from __future__ import annotations

from collections import deque

from unicon_base.arrays import Float64

SHORTEST_NS = 1_000_000
"""Two looks may be as close as they like, and are taken as so far apart, [ns]."""


class Speed:
    """The mean over the last while: one step of a finger's coarse angle would be a jerk.

    Args:
        over: how far the two angles are apart at least, once that much is known, in [s].
    """

    def __init__(self, over: float) -> None:
        self._over = round(over * 1e9)
        self._past: deque[tuple[int, Float64]] = deque()

    def __call__(self, stamp_ns: int, angles: Float64) -> Float64:
        """Return it in [rad/s], shape (n,); zero for the first angles.

        Args:
            stamp_ns: when the angles were told, [ns].
            angles: in [rad], shape (n,); they are kept.
        """
        past = self._past
        past.append((stamp_ns, angles))
        while len(past) > 2 and stamp_ns - past[1][0] >= self._over:
            past.popleft()
        before, then = past[0]
        speed: Float64 = (angles - then) / (max(stamp_ns - before, SHORTEST_NS) * 1e-9)
        return speed
