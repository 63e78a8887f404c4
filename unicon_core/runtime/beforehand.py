"""Beforehand: the ticks of a robot's run before its flow, for the runner and for replays."""

from __future__ import annotations

from unicon_core.blocks.approach import Approach
from unicon_core.flow import Deferred, Node, Zip, as_block
from unicon_core.gates.beginning import beginning
from unicon_core.workflow import Program

__all__ = ["approach_tree", "waiting_tree"]


def waiting_tree(program: Program, *waiting: Node) -> Node:
    """Return the tree of a tick in which nothing is sent: recv, estimate, input, observers."""
    return Zip(*program.hearing, *waiting, *map(Deferred, program.looking))


def approach_tree(program: Program) -> Node:
    """Return the tree of a tick of the approach, from the present states on."""
    start = program.start
    approach = Approach(
        program.states, beginning(program), program.period, start.approach, start.fade_in
    )
    return program.with_flow(as_block(approach))
