"""Puts bounds of the velocity command before a flow, and behind whatever gives commands in it."""

from __future__ import annotations

from collections.abc import Callable

from unicon_core.errors import WorkflowError
from unicon_core.flow import Block, Deferred, Node, Zip, as_block, blocks_of, children_of
from unicon_core.flow.nodes import chooser_of, with_children
from unicon_core.flow.stage import Stage
from unicon_core.workflow.command_bounds import (
    COMMAND,
    CommandBound,
    CommandBounds,
    command_bounds,
)
from unicon_core.workflow.policies import controllers_reading
from unicon_core.workflow.program_data import ProgramData


def bound_commands(program: ProgramData) -> tuple[CommandBound, ...]:
    """Put bounds before the flow of a program, and behind whatever gives commands in it.

    Returns:
        The bounds; none where nobody reads the command.

    Raises:
        WorkflowError: a condition or selector gives commands, behind which nothing can be put.
    """
    stages, states = program.stages, program.states
    early = _reads_command(stages[Stage.COMMAND])
    if not early and not _reads_command([*stages[Stage.FLOW], *stages[Stage.SAFETY]]):
        return ()
    readers = controllers_reading(COMMAND, program.blocks, program.policies)
    found = command_bounds(readers, program.robot)

    def bounds() -> Block:
        command, tick = states[COMMAND], states["tick"]
        return as_block(CommandBounds(command, found, tick, program.period, program.tell))

    stages[Stage.INPUT].append(bounds())
    for stage in (Stage.FLOW, *((Stage.COMMAND,) if early else ())):
        stages[stage] = [_bounded_flow(node, bounds) for node in stages[stage]]
    return found


def _bounded_flow(flow: Node, make: Callable[[], Block]) -> Node:
    """Return a tree with bounds behind every block in it that gives commands itself.

    Args:
        flow: of a workflow, or one of its `commands:`.
        make: makes a block of bounds.

    Raises:
        WorkflowError: a condition or selector gives commands, behind which nothing can be put.
    """
    if isinstance(flow, Block):
        gives = COMMAND in (*flow.writes, *flow.amends)
        return Zip(flow, make(), where=flow.where) if gives else flow
    if isinstance(flow, Deferred):
        return flow
    chooses = chooser_of(flow)
    if chooses is not None and COMMAND in (*chooses.writes, *chooses.amends):
        raise WorkflowError(
            f"block {chooses.name!r} chooses what runs and writes {COMMAND!r} beside it; let a "
            "block of its own write it",
            chooses.where or None,
        )
    return with_children(flow, [_bounded_flow(child, make) for child in children_of(flow)])


def _reads_command(nodes: list[Node]) -> bool:
    """Return whether any block in these nodes reads the command, beyond changing it."""
    return any(COMMAND in block.reads for node in nodes for block in blocks_of(node))
