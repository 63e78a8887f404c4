"""StartupSequence: the ticks of a robot's run before its flow, for the runner and for replays."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

from unicon_base.errors import Fault
from unicon_core.blocks.approach import Approach
from unicon_core.flow import Deferred, Node, Zip, as_block
from unicon_core.gates.build import beginning
from unicon_core.gates.gate import SoleCommander, StartGate
from unicon_core.platforms.joined import members_of
from unicon_core.platforms.platform import Prepares, SeesCommanders
from unicon_core.runtime.phases import Phase, RunOptions
from unicon_core.synchronised_start.meeting import Meeting
from unicon_core.synchronised_start.rendezvous import Rendezvous, WallClock
from unicon_core.workflow import Program
from unicon_core.workflow.program_data import NEVER_NS

Ticked = Callable[[Phase, Node, int | None], bool]
"""Ticks a tree until it is done, as a phase of the run; False where the run is to end.

The last argument is how late ticks may be in [ns], None where that is as in the run."""


class StartupSequence:
    """A run before its flow: gates and operator are waited for, then others, where it begins.

    Args:
        program: what runs.
        options: how.
        ticked: ticks for it.

    Attributes:
        first_ns: when the flow's first tick is due, as others know it; 0 for at once.
    """

    def __init__(self, program: Program, options: RunOptions, ticked: Ticked) -> None:
        self._program, self._options, self._ticked = program, options, ticked
        self._waiting: Waiting | None = None
        self._rendezvous: Rendezvous | None = None
        self.first_ns = 0

    def meet(self) -> None:
        """Join those with whom the flow begins, if there are any.

        Raises:
            UniconError: nobody can be met at the moment of the start.
        """
        self._rendezvous = rendezvous_of(self._program, self._options.speed, self._options.warn)

    def reason(self, phase: Phase) -> str:
        """Return what is waited for in a phase; "" where nothing is."""
        if phase is Phase.WAIT and self._waiting is not None and self._waiting.reason:
            return self._waiting.reason
        before = phase in (Phase.WAIT, Phase.APPROACH)
        return self._rendezvous.reason if before and self._rendezvous is not None else ""

    def go(self) -> bool:
        """Say that the robot may move; it counts where the operator alone is waited for."""
        return self._waiting is not None and self._waiting.go()

    def __call__(self, asks: bool) -> bool:
        """Wait for gates and operator, then approach where the flow begins; wait for others there.

        Args:
            asks: an operator has to say go.

        Returns:
            False where the run was asked to end before its flow.

        Raises:
            Fault: the platform has gone meanwhile.
        """
        program, warn = self._program, self._options.warn
        if program.platform.facts.simulated or not program.has_platform:
            return self._met()
        waiting = self._waiting = Waiting(program.gates, asks, warn, prepared(program))
        # The others learn that this one is there, and is not ready.
        here = [] if self._rendezvous is None else [as_block(self._rendezvous.here, name="here")]
        tree = waiting_tree(program, as_block(waiting), *here)
        if not self._ticked(Phase.WAIT, tree, NEVER_NS):
            return False
        if waiting.reason:
            raise self._gone(f"it was waited for {waiting.reason}")
        return self._approached()

    def _approached(self) -> bool:
        if not self._program.start.fade_in:
            return self._met()
        tree = approach_tree(self._program, self._rendezvous)
        return self._ticked(Phase.APPROACH, tree, None) and self._due()

    def _met(self) -> bool:
        """Wait for others where nothing is sent: in a simulator, or without approach."""
        if self._rendezvous is None:
            return True
        tree = waiting_tree(self._program, as_block(self._rendezvous.met, name="together"))
        return self._ticked(Phase.WAIT, tree, NEVER_NS) and self._due()

    def _due(self) -> bool:
        """Take over when the flow's first tick is due; it is behind all others' waiting."""
        if self._rendezvous is not None:
            self.first_ns = self._rendezvous.first_ns
            if not self.first_ns:
                raise self._gone("others were waited for")
        return True

    def _gone(self, when: str) -> Fault:
        return Fault(f"platform {self._program.platform.facts.name!r} has gone while {when}")

    def facts(self, first_ns: int) -> dict[str, Any]:
        """Return what the report says of a start with others, {} without.

        Args:
            first_ns: when the flow's first tick was.
        """
        return {} if self._rendezvous is None else {"start": self._rendezvous.facts(first_ns)}

    def close(self) -> None:
        """Leave the others."""
        if self._rendezvous is not None:
            self._rendezvous.close()


def rendezvous_of(program: Program, speed: str, warn: Callable[[str], None]) -> Rendezvous | None:
    """Return what a run asks before its flow, None where its workflow names no moment.

    Args:
        program: that is to run.
        speed: of the run: at full speed nobody is waited for, which is told.
        warn: takes one line each.

    Raises:
        UniconError: the moment has passed or is too far ahead, or nobody can be met.
    """
    start = program.start
    key = "at" if start.at is not None else "together"
    if (start.at is None and start.together is None) or not program.has_platform:
        return None
    if speed == "max":
        warn(f"start: {key} is not waited for with --speed max")
        return None
    if start.at is not None:
        start.at.refuse(time.time_ns())
        return Rendezvous(WallClock(start.at, start.alone), program.period, warn)
    assert start.together is not None
    if program.silent:  # others would begin because of it
        warn("start: together is not waited for by a run that sends nothing")
        return None
    return Rendezvous(Meeting(start.together, start.alone, program.period), program.period, warn)


def waiting_tree(program: Program, *waiting: Node) -> Node:
    """Return the tree of a tick in which nothing is sent: recv, estimate, input, observers."""
    return Zip(*program.hearing, *waiting, *map(Deferred, program.looking))


def prepared(program: Program) -> Callable[[], str] | None:
    """Return what brings a robot to where it takes commands, for `Waiting`; None: it does at once.

    Once its own controller has let go, nobody else may send commands to it.
    """
    platform = program.platform
    if not isinstance(platform, Prepares):
        return None
    members = [] if program.silent else members_of(platform, program.robot)
    alone = [
        SoleCommander(each.commanders)
        for _, each, _ in members
        if isinstance(each, Prepares) and isinstance(each, SeesCommanders)
    ]

    def prepare() -> str:
        return platform.prepare() or next(filter(None, (gate() for gate in alone)), "")

    return prepare


def approach_tree(program: Program, then: Callable[[bool], bool] | None = None) -> Node:
    """Return the tree of a tick of the approach, from the present states on.

    Args:
        program: whose robot it is.
        then: as of `Approach`.
    """
    start = program.start
    approach = Approach(
        program.states, beginning(program), program.period, start.approach, start.fade_in, then
    )
    return program.with_flow(as_block(approach))


PATIENCE = 30.0
"""How long gates may take to hold where no operator looks on, [s]."""

REPEAT = 5.0
"""How often what is waited for is told again, [s]."""

GRACE = 1.0
"""What is waited for in the first moments is not told, [s]: gates take half a second to measure."""

GO = "go"


class Waiting:
    """The block of the waiting phase: asks the gates, then the operator.

    Args:
        gates: asked in every tick.
        operator: somebody has to say go.
        warn: takes what is waited for, one line each.
        prepare: brings the robot to where it takes commands, behind the go; "" once it does.

    Attributes:
        reason: what is waited for, "" once nothing is.
    """

    def __init__(
        self,
        gates: Sequence[StartGate],
        operator: bool,
        warn: Callable[[str], None],
        prepare: Callable[[], str] | None = None,
    ) -> None:
        self._gates, self._operator, self._warn = gates, operator, warn
        self._prepare = prepare
        self._go = not operator
        self._began = self._told = 0.0
        self._what = ""
        self.reason = "the first data"

    def go(self) -> bool:
        """Say go; it counts where nothing else is waited for."""
        ready = self._what == GO
        self._go |= ready
        return ready

    def __call__(self) -> bool:
        now = time.monotonic()
        self._began = self._began or now
        what, reason = self._missing()
        self.reason = reason
        if not reason:
            return True
        if not self._operator and now - self._began > PATIENCE:
            raise Fault(f"not started, waited {PATIENCE:g} s for {reason}")
        heard = what == GO or now - self._began >= GRACE
        if heard and (what != self._what or now - self._told > REPEAT):
            self._what, self._told = what, now
            self._warn(f"waiting for {reason}")
        return False

    def _missing(self) -> tuple[str, str]:
        """Return the name of the first gate that does not hold, or else what comes after them."""
        for gate in self._gates:
            if reason := gate():
                name = getattr(gate, "name", "gate")  # it may be a plain function
                return name, f"{name}: {reason}"
        if self._go:
            reason = self._prepare() if self._prepare is not None else ""
            return ("robot", f"robot: {reason}") if reason else ("", "")
        return GO, "the operator's go: press Enter, call ~/start, or run with --yes"
