"""Phases and options of a run, for the runner and for code that reads what a run does.

wait → approach → run → soft → damp → off

A fault, or a second signal, leaves every phase for damp, the last one with commands.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from enum import Enum
from numbers import Real
from typing import Any, Literal, get_args

import numpy as np

from unicon_base.errors import Fault, PlatformError, UniconError, alternatives
from unicon_core.flow import CompiledGraph, Stage, Tick, Zip, as_block, compile_graph
from unicon_core.flow.nodes import never_done
from unicon_core.pacing import WallClock
from unicon_core.platforms.kit.command import BLEND, DAMPING_TIME, Damping
from unicon_core.platforms.platform import CountsArrivals, WaitsForData
from unicon_core.runtime.statistics import TickStatistics
from unicon_core.signals import Interrupted
from unicon_core.text_table import figures
from unicon_core.workflow import Program

WIND_DOWN = 5.0
"""Longest wind-down in [s]: a request to end a run must not wait for ever."""


class Phase(Enum):
    """What a run is at."""

    WAIT = "wait"
    """The platform is open, and nothing is sent. A robot's gates are asked in every tick until all
    hold; then the operator says go."""
    APPROACH = "approach"
    """A robot's joints go to where the flow begins, slowly and with stiffness that grows."""
    RUN = "run"
    """The flow ticks. The report's distances, falls and hash count this phase alone."""
    SOFT = "soft"
    """The flow of `wind_down:` ticks; recv, estimate, input, safety, send and observers go on."""
    DAMP = "damp"
    """The damping command is sent: stiffness falls to zero, targets stay, damping stays."""
    OFF = "off"
    """The platform has let go; nothing is sent any more."""


def describe(program: Program) -> list[tuple[str, str]]:
    """Return what each phase of a program does, for tables."""
    start, simulated = program.start, program.platform.facts.simulated
    gates = ", ".join(getattr(gate, "name", "gate") for gate in program.gates) or "none"
    if simulated:
        wait, approach = f"nothing: a simulator passes its gates ({gates})", "nothing"
    else:
        go = "; then for the operator's go" if start.operator else ""
        wait = f"gates: {gates}{go}"
        approach = (
            f"joints go to where the flow begins at {start.approach:g} rad/s, stiffness grows in "
            f"{start.fade_in:g} s"
        )
    if start.at is not None or start.together is not None:
        others = (
            f"; then {start.at.words} is waited for"
            if start.at
            else "; then the others are waited for"
        )
        if simulated or not start.fade_in:
            wait += others
        else:
            approach += others
    after = "" if program.duration is None else f" or for {program.duration:g} s"
    soft = f"wind_down: until it is done, at most {WIND_DOWN:g} s"
    return [
        (Phase.WAIT.value, wait),
        (Phase.APPROACH.value, approach),
        (Phase.RUN.value, f"the flow until it is done{after}"),
        (Phase.SOFT.value, "nothing: no wind_down" if program.wind_down is None else soft),
        (Phase.DAMP.value, f"stiffness to 0 within {BLEND:g} s, damping for {DAMPING_TIME:g} s"),
        (Phase.OFF.value, f"platform {program.platform.facts.name} is closed"),
    ]


class Damp:
    """Ticks the damping command: damps, sends, lets observers look, hears.

    What hears or looks and fails is left alone from then on. Safety blocks do not run: they are
    what may have tripped, and the damping command keeps the limits by itself.

    Args:
        program: what ran.

    Attributes:
        next_due_ns: when the next tick is due, on the clock of `time.perf_counter_ns`.
    """

    def __init__(self, program: Program) -> None:
        self._program = program
        self.next_due_ns = 0
        # Compiled now: in a fault a robot would wait for it.
        self._hear: Tick | None = compile_graph(Zip(*program.hearing)).step
        self._look: Tick | None = None
        if program.looking:
            self._look = compile_graph(Zip(*program.looking)).step

    def run(self, *, hear: bool) -> None:
        """Damp, at the program's rate; a simulator as fast as it goes.

        Args:
            hear: receive besides; what hung once is not asked again.

        Raises:
            Exception: what `send` raised; the platform is left to its own `close`.
        """
        program, now = self._program, time.perf_counter_ns
        states, platform, gate = program.states, program.platform, program.gate
        damping = Damping(states, program.robot, gate.sent, program.period)
        paced = not platform.facts.simulated
        clock, period = WallClock(0), round(program.period * 1e9)
        due, hears, look = now(), self._hear if hear else None, self._look
        for _ in range(max(1, round(DAMPING_TIME / program.period))):
            damping()
            if gate.closed:
                raise Fault("closed while it damped")
            program.sending()
            gate.sent.note()
            states["tick"][...] += 1
            due += period
            self.next_due_ns = due if paced else 0
            look = _tried(look)  # at what was sent, before anything new is heard
            hears = _tried(hears)
            if paced:
                clock.until(due)
                due = max(due, now() - period)  # after a stall, not all at once


def _tried(step: Tick | None) -> Tick | None:
    """Call it, and return it where it can be called again."""
    if step is not None:
        try:
            step()
        except Interrupted:  # a second signal has damped already
            raise
        except BaseException:  # a vendor's code may raise anything
            return None
    return step


Speed = Literal["real", "max"]

_PLATFORM = (Stage.RECV, Stage.SEND)


@dataclass(frozen=True)
class RunOptions:
    """How to run.

    Attributes:
        duration: end after this time in [s] of ticks; None: until the flow is done.
        speed: `real` paces to the wall clock; `max` ticks as fast as it can (simulators).
        capacity: ticks whose time stamps are kept.
        detail: each block of each tick gets a time stamp, also where they take longer than it.
        warn: takes warnings, one line each.
        status: called some times a second with facts for a status line, or None.
        operator: wait for `Runner.go` before a robot moves, where the workflow does not say that
            nobody is asked. False: the caller has decided.
        native: run blocks that have a C++ twin as native code, with the same commands.
        returns: a simulation may be set back.

    Raises:
        UniconError: `speed` is not a word of these, or `duration` not a number of at least 0.
    """

    duration: float | None = None
    speed: Speed = "real"
    capacity: int = 32_768
    detail: bool = False
    warn: Callable[[str], None] = print
    status: Callable[[dict[str, Any]], None] | None = None
    operator: bool = False
    native: bool = False
    returns: bool = True

    def __post_init__(self) -> None:
        if self.speed not in get_args(Speed):
            raise UniconError(f"speed is {self.speed!r}; give 'real' or 'max'")
        seconds = self.duration
        if seconds is None:
            return
        if not isinstance(seconds, Real) or not 0.0 <= seconds < math.inf:
            raise UniconError(f"duration is {seconds!r}; give seconds, as a number of at least 0")

    def ticks(self, program: Program) -> int:
        """Return after how many ticks a run ends at the latest."""
        duration = program.duration if self.duration is None else self.duration
        return 1 << 62 if duration is None else round(duration / program.period)

    def compiler(self, program: Program) -> Callable[..., CompiledGraph]:
        """Return what makes the graphs of a run."""
        if not self.native:
            return compile_graph
        from unicon_core.native.tick import NativeTick

        return NativeTick(program.states, self.warn).compile

    @classmethod
    def of(cls, options: Mapping[str, Any]) -> RunOptions:
        """Return the options of these names.

        Raises:
            UniconError: a name is unknown, or a value is wrong.
        """
        known = [each.name for each in fields(cls)]
        for name in options:
            if name not in known:
                raise UniconError(f"unknown option {name!r} of run; {alternatives(name, known)}")
        return cls(**options)


def never_ends(program: Program, options: RunOptions) -> bool:
    """Return True where it is proven that a run ends only when somebody ends it."""
    if options.duration is not None or program.duration is not None:
        return False
    given = [n for s, nodes in program.stages.items() if s not in _PLATFORM for n in nodes]
    return as_block(program.platform.recv).endless and all(map(never_done, given))


def refuse_pace(program: Program, options: RunOptions) -> None:
    """Refuse to run a program on a platform that cannot be paced so.

    Raises:
        PlatformError: it cannot.
    """
    platform, pacing = program.platform, program.pacing
    wrong = ""
    if pacing.trigger == "state" and not isinstance(platform, WaitsForData):
        wrong = "cannot tell when its data arrive; set pacing.trigger: deadline"
    elif pacing.every is not None and not isinstance(platform, CountsArrivals):
        wrong = "does not count its data; leave pacing.every out"
    elif options.speed == "max" and not platform.facts.simulated:
        wrong = "is a robot, which takes its time; leave out speed max, or use a simulator"
    elif pacing.overrun == "catch_up" and not platform.facts.simulated:
        wrong = (
            "is a robot, to which catch_up would send old commands in one go; set pacing.overrun: "
            "skip"
        )
    if wrong:
        raise PlatformError(f"platform {platform.facts.name!r} {wrong}")


def status_facts(
    statistics: TickStatistics, started_ns: int, program: Program, phase: Phase
) -> dict[str, Any]:
    """Return the facts of a status line; lateness is the worst one of the last second.

    Args:
        statistics: of the run.
        started_ns: when it began, [ns, perf_counter].
        program: of the run.
        phase: its present one.
    """
    count, rows, period = statistics.count, statistics.rows, program.period
    last = np.arange(max(count - round(1.0 / period), 0), count) % len(rows)
    late = float((rows[last, 2] - rows[last, 0]).max(initial=0)) * 1e-6
    facts = {
        f"{count * period:.1f} s": phase.value,
        f"{count * 1e9 / (time.perf_counter_ns() - started_ns):.1f} Hz": "",
        "late": f"{late:.1f} ms",
        "overruns": statistics.overruns,
    }
    if program.command_bounds:
        command = program.states["velocity_command"].reshape(-1)[:3]
        facts["command"] = " ".join(figures(command, ".2f"))
    return facts
