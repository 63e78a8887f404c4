"""ProgramData: what a program consists of, with the gate of its commands; `Program` builds it.

The gate is the last check before `send`: a closed workflow and a tick that hung send nothing. A
silent run (`unicon run --dry`, preflight) computes everything and sends nothing.

Command bounds are the largest velocity command that the flow ever sees. What gives it
(`commands:`, a topic, a block of one's own), the last thing before a reader is a clip: to the
`command_ranges` of the controllers that read it, else of the robot file, else to `CAUTIOUS`. Zero
is always allowed: it is what silence commands.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from unicon_base import Fault, Hung, TextSink
from unicon_base.arrays import Array, Float32
from unicon_core.blocks.approach import Monitor
from unicon_core.flow import Block, Node, Stage
from unicon_core.gates.gate import StartGate
from unicon_core.latches import Latch
from unicon_core.pacing import Pacing
from unicon_core.platforms.kit.command import LastSent
from unicon_core.platforms.platform import Platform
from unicon_core.policies import PolicyContract
from unicon_core.policies.controller import ControllerContract
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.links import Store
from unicon_core.states.standard import COMMAND_STATES
from unicon_core.workflow.autowire import BuildContext
from unicon_core.workflow.document import WorkflowDocument
from unicon_core.workflow.parts import Parts
from unicon_core.workflow.settings import StartSettings

COMMAND = "velocity_command"

CAUTIOUS = {"vx": 1.0, "vy": 0.5, "wz": 1.0}
"""Largest magnitudes where nobody says any, [m/s], [m/s], [rad/s]."""

CALM = 2.0
"""Time within the bounds after which an episode is over, [s]: each is told once."""

_POLICY_KEYS = {"vx": "lin_vel_x", "vy": "lin_vel_y", "wz": "ang_vel_z"}
_UNITS = {"vx": "m/s", "vy": "m/s", "wz": "rad/s"}


@dataclass(frozen=True)
class CommandBound:
    """What one element of the command is held to.

    Attributes:
        axis: `vx`, `vy` or `wz`.
        low, high: in [m/s] or [rad/s]; zero lies between them.
        sources: who says low and high.
        given: whether a policy or the robot file says them.
    """

    axis: str
    low: float
    high: float
    sources: tuple[str, str]
    given: bool

    @property
    def unit(self) -> str:
        """Its unit."""
        return _UNITS[self.axis]


def command_bounds(
    readers: Sequence[tuple[str, ControllerContract]], robot: Robot
) -> tuple[CommandBound, ...]:
    """Return the bounds of vx, vy and wz; of several controllers the tightest.

    Args:
        readers: the controllers in use that read the command, with what to call them.
        robot: what its file says counts for controllers that say nothing.
    """
    bounds = []
    for axis, cautious in CAUTIOUS.items():
        said = f"neither policy nor {robot.path.name} has command_ranges"
        fallback = (-cautious, cautious), said, False
        if axis in robot.command_ranges:
            fallback = robot.command_ranges[axis], f"command_ranges of robot {robot.name}", True
        pairs = [(who, each.command_ranges.get(_POLICY_KEYS[axis])) for who, each in readers]
        found = [
            fallback
            if pair is None or not all(map(math.isfinite, pair))
            else (pair, f"command_ranges of {label}", True)
            for label, pair in pairs
        ] or [fallback]
        low = max(found, key=lambda each: each[0][0])
        high = min(found, key=lambda each: each[0][1])
        lowest, highest = float(np.float32(low[0][0])), float(np.float32(high[0][1]))
        ends, sources = (min(lowest, 0.0), max(highest, 0.0)), (low[1], high[1])
        bounds.append(CommandBound(axis, *ends, sources, low[2] and high[2]))
    return tuple(bounds)


class CommandBounds:
    """The tick: clips in place. What is not finite commands nothing that is known: it becomes zero.

    Args:
        command: vx, vy [m/s], wz [rad/s], shape (..., 3).
        bounds: of vx, vy and wz.
        tick: number of the present tick.
        period: of a tick in [s].
        warn: gets one line for each episode.
    """

    memory = ("_last",)

    name = "command bounds"
    amends = (COMMAND,)
    endless = True

    def __init__(
        self,
        command: Float32,
        bounds: tuple[CommandBound, ...],
        tick: Array,
        period: float,
        warn: TextSink,
    ) -> None:
        self._rows = command.reshape(-1, 3)
        self._first = self._rows[0]
        self._bounds, self._tick, self._warn = bounds, tick, warn
        self._calm = max(1, round(CALM / period))
        self._low = np.array([each.low for each in bounds], np.float32)
        self._high = np.array([each.high for each in bounds], np.float32)
        (self._x0, self._x1), (self._y0, self._y1), (self._z0, self._z1) = (
            (each.low, each.high) for each in bounds
        )
        self._last: dict[tuple[str, bool], int] = {}
        if len(self._rows) > 1:
            self.warm_up = self.within = self._all_within  # type: ignore[method-assign]

    def __call__(self) -> None:
        if not self.within():
            self._amend()

    def within(self) -> bool:
        """Return whether all is within its bounds: 0.3 µs, of Python's own numbers."""
        command: list[float] = self._first.tolist()
        x, y, z = command
        return self._x0 <= x <= self._x1 and self._y0 <= y <= self._y1 and self._z0 <= z <= self._z1

    warm_up = within

    def _all_within(self) -> bool:
        rows = self._rows
        return bool((rows >= self._low).all() and (rows <= self._high).all())

    def _amend(self) -> None:
        for row in self._rows:
            values = row.tolist()
            finite = all(map(math.isfinite, values))
            for bound, value in zip(self._bounds, values):
                beyond = finite and not bound.low <= value <= bound.high
                if beyond or not math.isfinite(value):
                    self._tell(bound, value)
            if finite:
                np.maximum(row, self._low, out=row)
                np.minimum(row, self._high, out=row)
            else:
                row[...] = 0.0

    def _tell(self, bound: CommandBound, value: float) -> None:
        tick = int(self._tick.flat[0])  # of a batch all have the same
        key = bound.axis, math.isfinite(value)
        since = tick - self._last.get(key, tick + 1)
        self._last[key] = tick
        if 0 <= since <= self._calm:
            return
        told = f"{COMMAND} {bound.axis} is {value:g}"
        if not key[1]:
            self._warn(f"{told}: the whole command is zero")
            return
        low = value < bound.low
        limit = bound.low if low else bound.high
        self._warn(f"{told}, held to {limit:g} {bound.unit} ({bound.sources[not low]})")


NEVER_NS = 1 << 62
CLOSED = "the workflow is closed and sends nothing any more; build it anew"


class Gate:
    """Lets commands pass until a time, and remembers the last.

    Args:
        sent: takes what has passed.

    Attributes:
        until_ns: on the clock of `time.perf_counter_ns`; what comes to `send` later is refused.
            The runner moves it on with every tick.
        hung: tells what is said of a tick that comes later than that.
        closed: nothing passes any more.
        sent: what has passed last.
    """

    def __init__(self, sent: LastSent) -> None:
        self.sent = sent
        self.until_ns = NEVER_NS
        self.hung: Callable[[], str] = lambda: "a command came too late and was not sent"
        self.closed = False

    def before(self, send: Callable[[], bool | None]) -> Callable[[], bool | None]:
        """Return `send` behind the gate, which costs a tick 0.3 µs.

        Args:
            send: the platform's; of a silent run what stands in its place.

        What is returned raises:
            Fault: the workflow is closed, or the tick took longer than the runner allows.
        """
        now, note = time.perf_counter_ns, self.sent.note

        def guarded() -> bool | None:
            if self.closed or now() > self.until_ns:
                raise Fault(CLOSED) if self.closed else Hung(self.hung())
            done = send()
            note()
            return done

        return guarded

    def close(self) -> None:
        """Let nothing pass any more."""
        self.closed = True


def withheld(platform: Platform, states: States) -> Callable[[], bool | None]:
    """Return what a silent run does in place of `send`.

    A robot gets nothing. A simulator gets limp joints, since its time goes on with `send` alone;
    the command states hold again afterwards what would have been sent.

    Args:
        platform: of the program.
        states: of the program.
    """
    if not platform.facts.simulated:
        return bool
    views = [(states[name], np.zeros_like(states[name])) for name in COMMAND_STATES]
    target, measured = states["joint_pos_target"], states["joint_pos"]

    def limp() -> bool | None:
        for view, kept in views:
            kept[...] = view
            view[...] = 0.0
        target[...] = measured
        try:
            return platform.send()
        finally:
            for view, kept in views:
                view[...] = kept

    return limp


class ProgramData:
    """Robot, platform, states and the graph of a tick.

    Attributes:
        document: what it was built from, for messages and the check.
        name: of the workflow.
        dry: no hardware is open, and nothing is published.
        silent: nothing is sent; see the argument.
        part: of a divided workflow, "" for all of it.
        parts: what the workflow says of its parts, or None.
        store: where its states go besides, or None.
        robot: the robot file.
        policies: name to policy contract.
        period: of a tick in [s].
        duration: in [s] of ticks after which a run ends; None: when the flow is done.
        pacing: how ticks are timed.
        start: how a robot begins to move.
        states: all states.
        platform: the built platform.
        blocks: all blocks in order of building, for closing.
        outside: those of `blocks` that hooks gave.
        stages: the nodes of each stage, as they were given.
        root: the whole tree of a tick: what the command does not depend on is put off, and
            neighbouring copies are fused.
        wind_down: the same with the flow that follows the run, or None: the platform damps at once.
        critical: the blocks that the command depends on.
        monitor: watches the run for its report.
        gate: what every command passes last.
        gates: asked before anything is sent, until all hold.
        sending: `send` of the platform, without the gate; of a silent run what stands for it.
        hearing: what a tick without commands runs: recv, estimate, input.
        looking: observers, but for the report.
        command_bounds: what the velocity command is held to; empty where nobody reads it.
        safety: labels of the blocks of its own between the flow and `send`.
        latches: of the robots that it drives, which an emergency stop sets; none of simulators.
        safety_left_out: of a robot, safety blocks that it does not have, each with the reason.
        warn: takes what blocks tell while they tick, one line each; the runner sets its own.
        paced: the clock paces ticks; else they are as fast as they can.
        forced: codes of the check's errors that somebody decided to run with.
    """

    document: WorkflowDocument
    name: str
    dry: bool
    silent: bool
    part: str
    parts: Parts | None
    store: Store | None
    robot: Robot
    policies: dict[str, PolicyContract]
    period: float
    duration: float | None
    pacing: Pacing
    start: StartSettings
    states: States
    context: BuildContext
    platform: Platform
    blocks: list[Block]
    outside: list[Block]
    stages: dict[Stage, list[Node]]
    root: Node
    wind_down: Node | None
    critical: frozenset[Block]
    monitor: Monitor
    gate: Gate
    gates: list[StartGate]
    sending: Callable[[], object]
    hearing: list[Node]
    looking: list[Node]
    command_bounds: tuple[CommandBound, ...]
    safety: tuple[str, ...]
    latches: list[Latch]
    safety_left_out: dict[str, str]
    warn: TextSink
    paced: bool
    forced: tuple[str, ...]
    _closed: bool

    @property
    def has_platform(self) -> bool:
        """Whether the robot is here: false of a part whose states come from another one."""
        return self.parts is None or self.part in ("", self.parts.first)

    # -- while it runs --------------------------------------------------------------------------

    def tell(self, message: str) -> None:
        """Hand on what a block reports to the sinks of that time."""
        self.warn(message)

    def close(self) -> None:
        """Close the platform first (it damps), then the blocks in reverse order of building, once.

        Nothing is sent from then on. Everything is closed before the first error is raised.
        """
        if self._closed:
            return
        self._closed = True
        self.gate.close()
        errors: list[Exception] = []
        closers: list[Callable[[], object]] = [self.platform.close]
        closers += [block.close for block in reversed(self.blocks) if block.close is not None]
        for close in closers:
            try:
                close()
            except Exception as error:
                errors.append(error)
        if errors:
            raise errors[0]

    def damp_now(self) -> bool:
        """Close in the middle of whatever runs, for a second signal; False where it closes already.

        The platform damps. What its closing finds wrong is not told: a signal handler has no ear.
        """
        if self._closed:
            return False
        with suppress(Exception):
            self.close()
        return True
