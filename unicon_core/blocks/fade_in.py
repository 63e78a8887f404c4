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

    def __call__(self) -> None:
        if self._tick < self._ticks:
            self._tick += 1
            self._stiffness *= np.float32(self._tick / self._ticks)

    def reset(self) -> None:
        """Fade in anew."""
        self._tick = 0
