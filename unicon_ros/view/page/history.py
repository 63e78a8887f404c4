"""History: the last seconds of the states that can be plotted."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from unicon_core.states import Layout
from unicon_ros.view.source import Snapshot

SECONDS = 12.0
"""So much is kept, in [s]."""

_RATE = 100.0  # rows a second at most; a page has fewer pixels
_WIDEST = 128  # elements; a wider state is a picture, not a curve

TIMING = ("late", "busy")
"""Columns beside the states, in [ms]: the worst of the ticks of a row."""


class History:
    """Rows of states over time, the oldest first.

    Args:
        layout: of the states; those of more than 128 elements are left out.
        period: of a tick in [s].

    Attributes:
        columns: state, or one of `TIMING`, to where it is in a row.
    """

    def __init__(self, layout: Layout, period: float) -> None:
        self._stride = max(1, round(1.0 / (_RATE * period)))
        self._period = period
        rows = max(2, round(SECONDS / (period * self._stride)))
        self.columns: dict[str, slice] = {}
        width = 0
        for name in TIMING:
            self.columns[name] = slice(width, width + 1)
            width += 1
        for name, spec in layout.specs.items():
            if spec.size <= _WIDEST:
                self.columns[name] = slice(width, width + spec.size)
                width += spec.size
        self._states = [(name, where) for name, where in self.columns.items()][len(TIMING) :]
        self._rows = np.zeros((2 * rows, width), np.float32)
        self._time = np.zeros(2 * rows)
        self._half, self._count, self._worst = rows, 0, (0.0, 0.0)
        self._since = 0

    def clear(self) -> None:
        """Forget all, as at a reset."""
        self._count = self._since = 0

    def take(self, tick: Snapshot) -> None:
        """Add a tick; one that is earlier than the last row begins anew."""
        moment = tick.tick * self._period
        if self._count and moment < self._time[self._count - 1]:
            self.clear()
        late, busy = self._worst if self._since else (0.0, 0.0)
        self._worst = max(late, tick.late_ns * 1e-6), max(busy, tick.busy_ns * 1e-6)
        self._since += 1
        if self._since < self._stride and self._count:
            return
        self._since = 0
        if self._count == 2 * self._half:
            self._rows[: self._half] = self._rows[self._half :]
            self._time[: self._half] = self._time[self._half :]
            self._count = self._half
        row = self._rows[self._count]
        row[: len(TIMING)] = self._worst
        for name, where in self._states:
            row[where] = tick.states[name].reshape(-1)
        self._time[self._count] = moment
        self._count += 1

    def last(self, seconds: float) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """Return times in [s], shape (m,), and rows, shape (m, width); views, the newest last."""
        time = self._time[: self._count]
        first = int(np.searchsorted(time, time[-1] - seconds)) if self._count else 0
        return time[first:], self._rows[first : self._count]
