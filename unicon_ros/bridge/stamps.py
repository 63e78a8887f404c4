"""Stamps: which time the published headers carry, for the bridge.

A simulator's `stamp_ns` is published as it is, and so is `/clock`. A real robot's stamp counts from
an origin of its own (its boot, this machine's boot); ROS wants the wall clock, which tf2
and other nodes compare it with. The offset between both is the smallest difference seen
over the last seconds: the least delayed sample, as NTP's clock filter picks it (RFC 5905, 10).
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

WINDOW_NS = 5_000_000_000
"""Length of a window of the filter; a clock adjustment is followed within two of them."""


class WallStamp:
    """A robot's stamps on the wall clock.

    Args:
        source: `stamp_ns` of the robot in [ns], int64 scalar; None where the platform has none.

    Attributes:
        out: the stamp on the wall clock in [ns], int64 scalar, written by each call.
    """

    name = "ros time"

    def __init__(self, source: NDArray[Any] | None) -> None:
        self.out = np.zeros((), np.int64)
        self.reads = () if source is None else ("stamp_ns",)
        self._source = source
        self._ends_ns = 0
        self._present = self._previous = 1 << 62

    def __call__(self) -> None:
        wall = time.time_ns()
        if self._source is None:
            self.out[...] = wall
            return
        stamp = int(self._source)
        difference = wall - stamp
        if wall > self._ends_ns or wall < self._ends_ns - 2 * WINDOW_NS:
            self._previous = self._present if self._ends_ns else difference
            self._present = difference
            self._ends_ns = wall + WINDOW_NS
        elif difference < self._present:
            self._present = difference
        self.out[...] = stamp + min(self._present, self._previous)
