"""The tree of a tick, made of its stages and checked, its safety blocks and its blocks' memory.

Bounds of the velocity command stand before the flow, and behind whatever gives commands in it.

A robot has safety blocks whatever its workflow lists. A workflow adds to them by listing others,
and sets their options by listing them. `safety: {only: […]}` and `safety: none` leave the rest out,
which is logged at every start and stands in the report.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

from unicon_base import AnyDict, UniconError, WorkflowError
from unicon_core.flow import (
    Block,
    CompiledGraph,
    Deferred,
    Node,
    Stage,
    Switch,
    Zip,
    as_block,
    blocks_of,
    fuse,
)
from unicon_core.flow.checks import check_graph, raise_first
from unicon_core.flow.critical_path import critical_path, is_patient
from unicon_core.flow.nodes import children_of, chooser_of, unfused, with_children
from unicon_core.memory import Memory
from unicon_core.platforms.platform import Platform
from unicon_core.states import States
from unicon_core.states.standard import (
    BASE_STATES,
    COMMAND_STATES,
    CONTROL_STATES,
    HARDWARE_STATES,
    unsaid_states,
)
from unicon_core.workflow.autowire import state_names
from unicon_core.workflow.build import Builder, factory_of
from unicon_core.workflow.live_twin import TWIN_STATES
from unicon_core.workflow.policies import controllers_reading
from unicon_core.workflow.program_data import (
    COMMAND,
    CommandBound,
    CommandBounds,
    ProgramData,
    command_bounds,
)
from unicon_core.workflow.registry import find_factory
from unicon_core.workflow.uses import EXPRESSION, Use

Stages = Mapping[Stage, Sequence[Node]]

GIVEN = ("tick", COMMAND, "joint_vel_target", "joint_effort_ff", *TWIN_STATES)
"""States that may be read though no block writes them before: the runner does, zero is meant, or a
twin tells what it saw a tick ago."""


def given_in(states: States) -> list[str]:
    """Return those of the states that may be read though no block writes them before."""
    return [*GIVEN, *unsaid_states(states.layout.specs)]


def tick_tree(stages: Stages, states: States) -> tuple[Node, frozenset[Block]]:
    """Return the checked tree of a tick, and the blocks that the command depends on.

    Raises:
        WorkflowError: blocks contradict each other.
    """
    acting = [n for stage, nodes in stages.items() if stage is not Stage.OBSERVE for n in nodes]
    # Observers only look: what they would find missing is no reason not to run.
    observing = [Deferred(node) for node in stages[Stage.OBSERVE]]
    raise_first(check_graph(Zip(*acting, *observing), states, given=given_in(states)))
    patient = [node for node in acting if is_patient(node)]
    sent = [node for node in acting if not is_patient(node)]
    path = critical_path(Zip(*sent, *observing, *map(Deferred, patient)))
    needed = path.critical.union(*(blocks_of(node) for node in patient))
    return fuse(path.root, states), needed


def with_flow(stages: Stages, flow: Node) -> dict[Stage, Sequence[Node]]:
    """Return the stages with another flow, which nobody commands.

    Safety blocks that look at what the other flow wrote, such as an observation, are left out:
    nobody writes it here.
    """
    left = [n for s in stages for n in stages[s] if s not in (Stage.COMMAND, Stage.FLOW)]
    ours = {state for node in (*left, flow) for b in blocks_of(node) for state in b.writes}
    acted = (*stages[Stage.COMMAND], *stages[Stage.FLOW])
    gone = {state for node in acted for b in blocks_of(node) for state in b.writes}
    gone -= {*ours, *GIVEN, *COMMAND_STATES}  # what looks at commands always stays
    safety = [
        node
        for node in stages[Stage.SAFETY]
        if gone.isdisjoint(state for b in blocks_of(node) for state in b.reads)
    ]
    return {**stages, Stage.COMMAND: [], Stage.FLOW: [flow], Stage.SAFETY: safety}


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
            chooses.where,
        )
    return with_children(flow, [_bounded_flow(child, make) for child in children_of(flow)])


def _reads_command(nodes: list[Node]) -> bool:
    """Return whether any block in these nodes reads the command, beyond changing it."""
    return any(COMMAND in block.reads for node in nodes for block in blocks_of(node))


def memory_of(program: ProgramData, graphs: Mapping[str, CompiledGraph], **others: Any) -> Memory:
    """Return the memory of a program's own blocks and of the compiled ticks, all phases together.

    What came from outside is left out: devices and the hooks, whose doing is in the ticks, and the
    platform.

    Args:
        program: its trees.
        graphs: phase to its compiled tick.
        others: what else counts, by label.
    """
    trees = [tree for tree in (program.root, program.wind_down) if tree is not None]
    holders = {**holders_of(program, trees), "sent": program.gate.sent, **graphs, **others}
    return Memory(holders, program.states.buffer)


def holders_of(program: ProgramData, trees: Iterable[Node]) -> AnyDict:
    """Return label to function of the blocks in some trees that a snapshot holds."""
    found: AnyDict = {}
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


def _label(name: str, taken: AnyDict) -> str:
    number, label = 1, name
    while label in taken:
        number += 1
        label = f"{name} {number}"
    return label


FIRST = "finite"
STOPS = (
    "command_stop",
    "range_stop",
    "velocity_stop",
    "tilt_stop",
    "hardware_stop",
    "remote_stop",
)
"""Behind `finite`, before what the workflow lists: they look at ranges, and neighbours which do so
become one comparison (`flow/fuse.py`)."""
LAST = ("joint_limits", "stale_stop", "imu_stop", "joint_sensor_stop", "encoder_stop")
"""Behind what the workflow lists: an encoder that stands at its joint's limit is not stuck, and the
target that it follows is the one within the limits."""

TELLS = {"hardware_stop": HARDWARE_STATES, "remote_stop": CONTROL_STATES}
"""Blocks that only a robot has which writes one of these states."""

ROBOT_SAFETY = (FIRST, *STOPS, *LAST)
"""What stands between the flow and `send` of anything that is not a simulator."""


def left_out(nodes: Iterable[Node], platform: Platform, members: Iterable[str] = ()) -> list[str]:
    """Return the names of a robot's safety blocks that are not among the nodes.

    Those for its hardware and its remote belong to a robot that tells of them. A block of one
    member is there only where every member has one.
    """
    covered: dict[object, set[str]] = {}
    for use in (block for node in nodes for block in blocks_of(node)):
        if isinstance(use, Use) and use.word != EXPRESSION:
            covered.setdefault(factory_of(use), set()).add(use.of)
    every, told = {*members} or {""}, {*platform.facts.writes}
    there = {made for made, of in covered.items() if "" in of or of >= every}
    return [
        name
        for name in ROBOT_SAFETY
        if (name not in TELLS or told & {*TELLS[name]})
        and find_factory("blocks", name, WorkflowError) not in there
    ]


def completed(
    program: ProgramData, builder: Builder, listed: Sequence[Node]
) -> tuple[list[Node], dict[str, str]]:
    """Return a robot's safety blocks, built, and why others are left out.

    A block that could not see anything is left out: nothing writes what it reads, or the robot
    file does not say its bounds.

    Args:
        program: its platform and the blocks of all other stages are built.
        builder: of the program.
        listed: what the workflow lists, not built yet.
    """
    missing = left_out(listed, program.platform, program.robot.members)
    told = {*program.platform.facts.writes, *COMMAND_STATES}
    if program.robot.imu is None:
        told -= {*BASE_STATES}
    told |= {state for block in program.blocks for state in block.writes}
    why: dict[str, str] = {}

    def add(*names: str) -> Iterator[Node]:
        for name in filter(missing.__contains__, names):
            factory = find_factory("blocks", name, WorkflowError)
            untold = [state for state in state_names(factory) if state not in told]
            if untold:
                why[name] = f"nothing measures {', '.join(untold)}"
                continue
            try:
                yield builder.built(Use(name))
            except UniconError as error:
                why[name] = str(error).removeprefix(f"block {name!r}: ").partition("; ")[0]

    own = [builder.built(node) for node in listed]
    finite = find_factory("blocks", FIRST, WorkflowError)
    firsts = (
        place
        for place, node in enumerate(listed, 1)
        if isinstance(node, Use) and not node.of and factory_of(node) is finite
    )
    begin = next(firsts, 0)
    front = [*own[:begin], *(() if begin else add(FIRST)), *add(*STOPS)]
    return [*front, *own[begin:], *add(*LAST)], why
