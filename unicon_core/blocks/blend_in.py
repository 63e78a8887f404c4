"""Blocks `blend_in` and `fade_in`: commands come in without a jump."""

from __future__ import annotations

import numpy as np

from unicon_core.blocks.joint_command import Counting, ticks_of
from unicon_core.bounds import Seconds
from unicon_core.flow.block import Amends, Stage
from unicon_core.workflow.autowire import BuildContext


class BlendIn(Counting):
    """Blend from the command that was sent last to the present one, then leave it alone.

    Stands behind a policy, in a zip: with K ticks, tick k = 1 … K after the entry sends
    (1 − w) · held + w · present, w = k / (K + 1), of targets and gains. Where nothing was sent
    before, nothing is blended.

    Args:
        joint_pos_target: in [rad], shape (..., n).
        joint_stiffness: in [N·m/rad], shape (..., n).
        joint_damping: in [N·m·s/rad], shape (..., n).
        joint_vel_target: in [rad/s], shape (..., n).
        joint_effort_ff: in [N·m], shape (..., n).
        duration: in [s].
    """

    memory = ("_held", "_own", "_mixed", "_sent")

    def __init__(
        self,
        joint_pos_target: Amends,
        joint_stiffness: Amends,
        joint_damping: Amends,
        joint_vel_target: Amends,
        joint_effort_ff: Amends,
        *,
        context: BuildContext,
        duration: Seconds = 0.5,
    ) -> None:
        live = (joint_pos_target, joint_stiffness, joint_damping, joint_vel_target, joint_effort_ff)
        self._sent, self._live = context.sent, live
        self._ticks, self._tick = ticks_of(duration, context.period), 0
        self._held, self._own, self._mixed = ([array.copy() for array in live] for _ in range(3))
        names = ("joint_pos_target", "joint_stiffness", "joint_damping")
        last = self._sent
        self._last = [] if last is None else [last.states[name] for name in names]

    def __call__(self) -> None:
        """Blend, for as many ticks as it lasts."""
        if self._tick >= self._ticks:
            return
        if self._tick == 0:
            if self._sent is None or not self._sent.any:
                self._tick = self._ticks
                return
            for held, last, mixed in zip(self._held, self._last, self._mixed):
                held[...] = last
                mixed[...] = np.nan
        self._tick += 1
        share = np.float32(self._tick / (self._ticks + 1))
        for live, held, own, mixed in zip(self._live, self._held, self._own, self._mixed):
            # A policy that does not run in every tick leaves what was mixed: not once more.
            np.copyto(own, live, where=live != mixed)
            np.subtract(own, held, out=live)
            live *= share
            live += held
            mixed[...] = live


class FadeIn(Counting):
    """Scale stiffness, velocity target and torque from 0 to 1 over a time, then leave them alone.

    Args:
        joint_stiffness: in [N·m/rad], shape (..., n).
        joint_vel_target: in [rad/s], shape (..., n).
        joint_effort_ff: in [N·m], shape (..., n).
        duration: in [s].
    """

    memory = ("_whole", "_left")

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
