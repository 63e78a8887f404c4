"""Beforehand: the ticks of a robot's run before its flow, for the runner and for replays."""

from __future__ import annotations

from collections.abc import Callable

from unicon_core.blocks.approach import Approach
from unicon_core.flow import Deferred, Node, Zip, as_block
from unicon_core.gates.beginning import beginning
from unicon_core.gates.standing import Alone
from unicon_core.platforms.joined import members_of
from unicon_core.platforms.platform import Prepares, SeesCommanders
from unicon_core.workflow import Program

__all__ = ["approach_tree", "prepared", "waiting_tree"]


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
