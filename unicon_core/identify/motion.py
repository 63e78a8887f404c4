"""Motion: what a robot measured and was commanded, tick by tick, cut into short windows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import UniconError
from unicon_core.platforms.kit.beside import PLACE
from unicon_core.states.standard import COMMAND_STATES

FEWEST = 8
"""Windows: with less there is nothing to hold a fit against."""
FALLEN = 0.5
"""Lean in [rad] from which on a walking robot falls: what comes then is not its joints' doing."""


@dataclass(frozen=True, eq=False)
class Motion:
    """A recorded run.

    Attributes:
        period: of a tick in [s].
        measured: of `PLACE`, those that were measured, each of shape (ticks, …).
        commands: the command states, each of shape (ticks, n).
        starts: first tick of each window, shape (windows,).
        length: ticks of a window; `measured` has one more behind it, of the same run.
    """

    period: float
    measured: Mapping[str, NDArray[Any]]
    commands: Mapping[str, NDArray[Any]]
    starts: NDArray[np.int64]
    length: int

    @staticmethod
    def of(
        states: Mapping[str, NDArray[Any]],
        period: float,
        usable: NDArray[np.bool_],
        window: float = 0.2,
        most: int = 200,
    ) -> Motion:
        """Cut a run into windows that overlap by half.

        Args:
            states: at the end of each tick, by name, shape (ticks, …): what was measured at its
                beginning and what was sent.
            period: of a tick in [s].
            usable: ticks that ended and follow the one before, shape (ticks,).
            window: in [s].
            most: windows; of more, as many are taken, evenly.

        Raises:
            UniconError: something is missing, or there are too few windows.
        """
        lacking = [n for n in ("joint_pos", "joint_vel", *COMMAND_STATES) if n not in states]
        if lacking:
            raise UniconError(
                f"identification needs {lacking[0]}, which was not recorded; record with "
                "unicon run --record"
            )
        length = max(round(window / period), 2)
        measured = {name: states[name] for name in PLACE if name in states}
        for name in PLACE[2:]:  # what nobody measured stands still, to the bit
            if name in measured and np.ptp(measured[name], axis=0).max(initial=0.0) == 0.0:
                del measured[name]
        commands = {name: states[name] for name in COMMAND_STATES}
        good = usable & ~_fallen(states)
        for values in (*measured.values(), *commands.values()):
            good &= np.isfinite(values).reshape(len(values), -1).all(axis=1)
        moved = np.ptp(states["joint_pos"][good], axis=0).max(initial=0.0) if good.any() else 0.0
        runs = np.convolve(good, np.ones(length + 2), "valid") > length + 1.5
        starts = np.flatnonzero(runs)[:: max(length // 2, 1)] + 1  # a tick before, for delays
        if len(starts) < FEWEST or moved < 0.02:
            raise UniconError(
                f"identification needs at least {FEWEST} windows of {length * period:g} s in which "
                f"joints move; the run has {len(starts)}, and joints move by {moved:.3f} rad; "
                "record a longer run, or one with excite"
            )
        if len(starts) > most:
            starts = starts[np.linspace(0, len(starts) - 1, most).round().astype(int)]
        return Motion(period, measured, commands, starts, length)

    @property
    def answers(self) -> NDArray[np.float64]:
        """Measured joint positions in [rad] after each tick of each window, shape (w, l, n)."""
        rows = self.starts[:, None] + np.arange(1, self.length + 1)
        return np.asarray(self.measured["joint_pos"][rows], np.float64)


def _fallen(states: Mapping[str, NDArray[Any]]) -> NDArray[np.bool_]:
    gravity = states.get("projected_gravity")
    if gravity is None or np.ptp(gravity) == 0.0:
        return np.zeros(len(states["joint_pos"]), np.bool_)
    fallen: NDArray[np.bool_] = np.maximum.accumulate(-gravity[:, 2] < np.cos(FALLEN))
    return fallen
