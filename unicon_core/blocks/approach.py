"""What brings a robot to where its flow begins, and the flow's first commands in without a jump."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from unicon_base.arrays import Float32
from unicon_core.blocks.joint_command import Counting
from unicon_core.platforms.kit.damping import LastSent
from unicon_core.states import States
from unicon_core.states.standard import COMMAND_STATES


@dataclass(frozen=True, eq=False)
class Target:
    """Where joints are to be and how stiffly, in the robot's order, each of shape (n,).

    Attributes:
        joint_pos: in [rad].
        stiffness: in [N·m/rad].
        damping: in [N·m·s/rad].
        source: who says so, for messages.
    """

    joint_pos: Float32
    stiffness: Float32
    damping: Float32
    source: str


class Approach:
    """Moves all joints at once from where they were measured, while stiffness grows from zero.

    Args:
        states: whose command states are written.
        beginning: where to.
        period: of a tick in [s].
        speed: of the fastest joint in [rad/s].
        fade_in: how long stiffness grows in [s].
        then: told in each tick whether they have arrived; they stay there until it is true. None:
            no longer than that.
    """

    memory = ("_from", "_way", "_tick")

    name = "approach"
    reads = ("joint_pos",)
    writes = COMMAND_STATES

    def __init__(
        self,
        states: States,
        beginning: Target,
        period: float,
        speed: float,
        fade_in: float,
        then: Callable[[bool], bool] | None = None,
    ) -> None:
        self._states, self._beginning, self._then = states, beginning, then
        self._from = states["joint_pos"].copy()
        self._way = beginning.joint_pos - self._from
        distance = float(np.abs(self._way).max(initial=0.0))
        self._move = max(1, round(distance / speed / period))
        self._fade = max(1, round(fade_in / period))
        self._tick = 0

    def __call__(self) -> bool:
        self._tick += 1
        states, tick = self._states, self._tick
        share = np.float32(min(tick / self._move, 1.0))
        np.multiply(self._way, share, out=states["joint_pos_target"])
        states["joint_pos_target"] += self._from
        states["joint_vel_target"][...] = 0.0
        states["joint_effort_ff"][...] = 0.0
        grown = np.float32(min(tick / self._fade, 1.0))
        np.multiply(self._beginning.stiffness, grown, out=states["joint_stiffness"])
        states["joint_damping"][...] = self._beginning.damping
        arrived = tick >= max(self._move, self._fade)
        return arrived if self._then is None else self._then(arrived)


class Entry(Counting):
    """Blends from what was sent last to what the flow commands; for a robot's first ticks.

    The first action of a policy may be a radian away from the posture in which it is entered.

    Args:
        states: whose command states are amended.
        last: what was sent last.
        ticks: length of the blend.
    """

    memory = ("_held", "_last")

    name = "entry"
    reads = ("joint_pos",)
    amends = COMMAND_STATES

    def __init__(self, states: States, last: LastSent, ticks: int) -> None:
        self._held = [last.states[name].copy() for name in COMMAND_STATES]
        self._pairs = [(states[name], held) for name, held in zip(COMMAND_STATES, self._held)]
        self._last, self._ticks, self._tick = last, ticks, 0
        self._measured = states["joint_pos"]

    def __call__(self) -> None:
        if self._tick >= self._ticks:
            return
        if self._tick == 0:
            for (_, held), name in zip(self._pairs, COMMAND_STATES):
                held[...] = self._last.states[name]
            if not self._last.any:  # whoever ticks by himself has left out the approach
                self._pairs[0][1][...] = self._measured
        self._tick += 1
        share = np.float32(self._tick / self._ticks)
        for live, held in self._pairs:
            live -= held
            live *= share
            live += held
