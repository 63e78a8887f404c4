"""Blocks of this package, by name through the entry point group `unicon.blocks`."""

from __future__ import annotations

import math

from unicon_core.flow import Reads, Tick, Writes

__all__ = ["look_around"]


def look_around(
    tick: Reads, gaze_command: Writes, *, period: float, width: float = 0.6, seconds: float = 4.0
) -> Tick:
    """Turn the gaze from side to side, until a message tells another one.

    Args:
        tick: number of the present tick.
        gaze_command: pan and tilt that are wanted in [rad], shape (2,).
        period: of a tick in [s].
        width: largest pan in [rad].
        seconds: of one turn to both sides and back.
    """

    def turn() -> None:
        gaze_command[0] = width * math.sin(2.0 * math.pi * float(tick) * period / seconds)
        gaze_command[1] = 0.0

    return turn
