"""The safety blocks that a robot has whatever its workflow lists; for `Program`.

A workflow adds to them by listing others, and sets their options by listing them. `safety: {only:
[…]}` and `safety: none` leave the rest out, which is told at every start and stands in the report.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from unicon_base import UniconError, WorkflowError
from unicon_core.flow import Node, blocks_of
from unicon_core.platforms.platform import Platform
from unicon_core.states.standard import BASE_STATES, COMMAND_STATES, CONTROL_STATES, HARDWARE_STATES
from unicon_core.workflow.autowire import state_names
from unicon_core.workflow.build import Builder, factory_of
from unicon_core.workflow.program_data import ProgramData
from unicon_core.workflow.registry import find_factory
from unicon_core.workflow.uses import EXPRESSION, Use

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
    whole = [node if isinstance(node, Use) and not node.of else None for node in listed]
    is_first = [node is not None and factory_of(node) is finite for node in whole]
    begin = is_first.index(True) + 1 if True in is_first else 0
    front = [*own[:begin], *(() if begin else add(FIRST)), *add(*STOPS)]
    return [*front, *own[begin:], *add(*LAST)], why
