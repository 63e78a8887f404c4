"""The memory of a program: what of its blocks and graphs a snapshot holds."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from unicon_core.flow import Node, Stage, Switch
from unicon_core.flow.compiled import CompiledGraph
from unicon_core.flow.nodes import children_of, unfused
from unicon_core.memory import Memory
from unicon_core.workflow.program_data import ProgramData


def memory_of(
    program: ProgramData, graphs: Mapping[str, CompiledGraph], *, platform: bool = False
) -> Memory:
    """Return the memory of a program's own blocks and of the compiled ticks, all phases together.

    What came from outside is left out: devices and the hooks, whose doing is in the ticks, and the
    platform, unless it is asked for.

    Args:
        program: its trees.
        graphs: phase to its compiled tick.
        platform: whether that of a simulator counts, too.
    """
    trees = [tree for tree in (program.root, program.wind_down) if tree is not None]
    holders = {**holders_of(program, trees), "sent": program.gate.sent, **graphs}
    if platform:
        holders["platform"] = program.platform
    return Memory(holders, program.states.buffer)


def holders_of(program: ProgramData, trees: Iterable[Node]) -> dict[str, Any]:
    """Return label to function of the blocks in some trees that a snapshot holds."""
    found: dict[str, Any] = {}
    for node in dict.fromkeys(node for tree in trees for node in _nodes(tree)):
        if isinstance(node, Switch) and node.blender is not None:
            found[_label("blend", found)] = node.blender
        for block in unfused(node):
            # Of the observers those count that write states, which a safety block may read.
            seen = block.stage is Stage.OBSERVE and not block.writes
            device = getattr(block.tick, "outside", False)
            foreign = block.stage in (Stage.RECV, Stage.SEND)
            if not (foreign or seen or device or block in program.outside):
                found[_label(block.name, found)] = block.tick
    return found


def _nodes(node: Node) -> Iterator[Node]:
    yield node
    for child in children_of(node):
        yield from _nodes(child)


def _label(name: str, taken: dict[str, Any]) -> str:
    number, label = 1, name
    while label in taken:
        number += 1
        label = f"{name} {number}"
    return label
