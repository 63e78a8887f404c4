"""Block `fade_in`: blends the stiffness in, so that no joint jumps when a controller starts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from unicon_core.blocks.joint_command import ticks_of
from unicon_core.flow.block import Amends
from unicon_core.flow.stage import Stage

__all__ = ["FadeIn", "fade_in"]


def fade_in(joint_stiffness: Amends, *, period: float, duration: float = 1.0) -> FadeIn:
    """Scale the stiffness from 0 to 1 over a time, then leave it alone.

    Args:
        joint_stiffness: in [N·m/rad], shape (..., n).
        duration: in [s].
    """
    return FadeIn(joint_stiffness, ticks_of(duration, period, "duration") or 1)


class FadeIn:
    """The tick of `fade_in`."""

    stage = Stage.SAFETY

    def __init__(self, stiffness: NDArray[np.float32], ticks: int) -> None:
        self._stiffness, self._ticks, self._tick = stiffness, ticks, 0
        self._whole, self._faded = stiffness.copy(), np.full_like(stiffness, np.nan)

    def __call__(self) -> None:
        if self._tick < self._ticks:
            self._tick += 1
            live = self._stiffness
            # A policy that does not run in every tick leaves what was faded: not once more.
            np.copyto(self._whole, live, where=live != self._faded)
            np.multiply(self._whole, np.float32(self._tick / self._ticks), out=live)
            self._faded[...] = live

    def reset(self) -> None:
        """Fade in anew."""
        self._tick = 0
