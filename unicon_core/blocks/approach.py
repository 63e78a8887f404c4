"""Around a flow: approach, entry and blends that avoid a jump, and the monitor of a run."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from unicon_base import AnyDict
from unicon_base.arrays import Float32
from unicon_core.blocks.postures import Counting, ticks_of
from unicon_core.bounds import Seconds
from unicon_core.flow.block import Amends, Stage
from unicon_core.platforms.kit.command import LastSent
from unicon_core.states import States
from unicon_core.states.standard import COMMAND_STATES
from unicon_core.states.states import flat
from unicon_core.workflow.autowire import BuildContext


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
        self._states = states
        self._beginning = beginning
        self._then = then
        self._from = states["joint_pos"].copy()
        self._way = beginning.joint_pos - self._from
        distance = float(np.abs(self._way).max(initial=0.0))
        self._move = max(1, round(distance / speed / period))
        self._fade = max(1, round(fade_in / period))
        self._tick = 0

    def __call__(self) -> bool:
        self._tick += 1
        states = self._states
        tick = self._tick
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
        self._last = last
        self._ticks = ticks
        self._measured = states["joint_pos"]

    def __call__(self) -> None:
        if self._tick >= self._ticks:
            return
        if self._tick == 0:
            for (_, held), name in zip(self._pairs, COMMAND_STATES):
                held[...] = self._last.states[name]
            if not self._last.any:  # a caller that ticks by itself has left out the approach
                self._pairs[0][1][...] = self._measured
        self._tick += 1
        share = np.float32(self._tick / self._ticks)
        for live, held in self._pairs:
            live -= held
            live *= share
            live += held


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
        self._sent = context.sent
        self._live = live
        self._ticks = ticks_of(duration, context.period)
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
        self._ticks = ticks_of(duration, period)
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


class Monitor:
    """Watches a run for its report: displacement, fall, hash of the commands; after `send`.

    Args:
        states: of the workflow.
        dry: nothing is sent.
        fixed: the base cannot move, so that it neither falls nor gets anywhere.

    Attributes:
        held: a gantry holds the base, so that it cannot fall; the builder says it.
    """

    FALL_COSINE = 0.5
    """Cosine of the tilt that counts as a fall: 60° from upright."""
    FALL_HEIGHT = 0.5
    """Share of its height at first below which a base has sunk."""
    ODOMETRY = 0.1
    """Height in [m] up to which no base is judged: an odometry may begin at a zero of its own."""

    name = "report"
    reads = ("base_pos_w", "projected_gravity", *COMMAND_STATES)

    def __init__(self, states: States, *, dry: bool = False, fixed: bool = False) -> None:
        self._dry = dry
        self._fixed = fixed
        self.held = False
        self._pos = states["base_pos_w"].reshape(-1, 3)
        gravity = states["projected_gravity"].reshape(-1, 3)[:, 2]
        # `max` takes 1.3 µs where one number takes 0.1.
        self._least_upright = partial(gravity.item, 0) if len(gravity) == 1 else gravity.max
        self._start = self._pos.copy()
        self._commands = [view.data for view in flat([states[n] for n in COMMAND_STATES])]
        self.begin()

    def begin(self) -> None:
        """Begin a run; that of before does not count any more."""
        self._started = False
        self._hash = hashlib.sha256()
        self._worst = -1.0

    def __call__(self) -> None:
        if not self._started:
            self._start[...] = self._pos
            self._started = True
        for view in self._commands:
            self._hash.update(view)
        upright = self._least_upright()
        if not upright <= self._worst:
            self._worst = upright if upright > self._worst else 1.0  # NaN is the worst

    @property
    def fell(self) -> bool:
        """Whether the base tilted further than a walking robot comes back from."""
        return not self._worst <= -self.FALL_COSINE

    @property
    def sha256(self) -> str:
        """SHA-256 over the command states of every tick so far."""
        return self._hash.hexdigest()

    def finish(self) -> None:
        """Let nothing count that comes from here on."""
        self._pos = self._pos.copy()

    def found(self) -> AnyDict:
        """Return what was seen: fields of a report."""
        seen: AnyDict = {"sha256_commands": self.sha256, "dry": self._dry}
        if self._fixed:
            return seen | dict.fromkeys(("base_displacement_m", "fell", "tilt_deg"))
        moved = self._pos[0] - self._start[0] if self._started else np.zeros(3)
        first = self._start[0, 2]
        known = self._started and first > self.ODOMETRY  # else it may begin at a zero of its own
        tilt = math.degrees(math.acos(max(-1.0, min(-self._worst, 1.0))))
        return seen | {
            "base_displacement_m": [round(float(value), 6) for value in moved],
            "fell": None if self.held else self.fell,
            "sank": bool(known and first + moved[2] < self.FALL_HEIGHT * first),
            "tilt_deg": round(tilt, 1),
        }
