"""RunOptions: how a program is to be run, and whether its platform can be; for the runner."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from numbers import Real
from typing import Any, Literal, get_args

from unicon_base.errors import PlatformError, UniconError, alternatives
from unicon_core.flow import Stage, as_block
from unicon_core.flow.nodes import never_done
from unicon_core.platforms.platform import WaitsForData
from unicon_core.workflow import Program

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
        status: called about once a second with facts for a status line, or None.
        operator: wait for `Runner.go` before a robot moves, where the workflow does not say that
            nobody is asked. False: whoever runs it has decided.

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
    elif options.speed == "max" and not platform.facts.simulated:
        wrong = "is a robot, which takes its time; leave out speed max, or use a simulator"
    elif pacing.overrun == "catch_up" and not platform.facts.simulated:
        wrong = (
            "is a robot, to which catch_up would send old commands in one go; set pacing.overrun: "
            "skip"
        )
    if wrong:
        raise PlatformError(f"platform {platform.facts.name!r} {wrong}")
