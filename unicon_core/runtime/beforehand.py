"""Beforehand: the ticks of a robot's run before its flow, for the runner and for replays."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from unicon_core.blocks.approach import Approach
from unicon_core.errors import Fault
from unicon_core.flow import Deferred, Node, Zip, as_block
from unicon_core.gates.beginning import beginning
from unicon_core.gates.standing import Alone
from unicon_core.platforms.joined import members_of
from unicon_core.platforms.platform import Prepares, SeesCommanders
from unicon_core.runtime.options import RunOptions
from unicon_core.runtime.phases import Phase
from unicon_core.runtime.waiting import Waiting
from unicon_core.together.rendezvous import Rendezvous, rendezvous_of
from unicon_core.workflow import Program
from unicon_core.workflow.gate import NEVER_NS


class Ticked(Protocol):
    """Ticks a tree until it is done, as a phase of the run; False where the run is to end."""

    def __call__(self, phase: Phase, tree: Node, hang_ns: int | None = None) -> bool:
        """Tick; `hang_ns` is how late ticks may be, where that is not as in the run."""
        ...


class Beforehand:
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
        return self._ticked(Phase.APPROACH, tree) and self._due()

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
        Alone(each.commanders)
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
