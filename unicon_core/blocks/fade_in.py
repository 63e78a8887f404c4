"""Block `fade_in`: blends commands in, so that no joint jumps when a controller starts."""

from __future__ import annotations

import numpy as np

from unicon_core.blocks.joint_command import ticks_of
from unicon_core.bounds import Seconds
from unicon_core.flow.block import Amends
from unicon_core.flow.stage import Stage


class FadeIn:
    """Scale stiffness, velocity target and torque from 0 to 1 over a time, then leave them alone.

    Args:
        joint_stiffness: in [N·m/rad], shape (..., n).
        joint_vel_target: in [rad/s], shape (..., n).
        joint_effort_ff: in [N·m], shape (..., n).
        duration: in [s].
    """

    memory = ("_whole", "_left", "_tick")

    stage = Stage.SAFETY

    def __init__(
        self,
        joint_stiffness: Amends,
        joint_vel_target: Amends,
        joint_effort_ff: Amends,
        *,
        period: float,
        duration: Seconds = 1.0,
    ) -> None:
        faded = (joint_stiffness, joint_vel_target, joint_effort_ff)
        self._ticks, self._tick = ticks_of(duration, period), 0
        # What is there, what it was whole, and what was left of it in the tick before.
        self._whole = [live.copy() for live in faded]
        self._left = [np.full_like(live, np.nan) for live in faded]
        self._views = list(zip(faded, self._whole, self._left))

    def __call__(self) -> None:
        if self._tick < self._ticks:
            self._tick += 1
            share = np.float32(self._tick / self._ticks)
            for live, whole, left in self._views:
                # A policy that does not run in every tick leaves what was faded: not once more.
                np.copyto(whole, live, where=live != left)
                np.multiply(whole, share, out=live)
                left[...] = live

    def reset(self) -> None:
        """Fade in anew."""
        self._tick = 0
