"""Where the flow of a program begins, and its first command; for the approach and for preflight."""

from __future__ import annotations

import numpy as np

from unicon_core.blocks.approach import Target
from unicon_core.blocks.joint_command import robot_gains
from unicon_core.blocks.postures import Damp, Hold, Pose
from unicon_core.flow import Block, Node, Switch, Zip, children_of, compile_graph
from unicon_core.flow.block import Stage
from unicon_core.flow.nodes import chooser_of
from unicon_core.memory import Memory
from unicon_core.policies.controller import controller_contract
from unicon_core.robots import joint_index
from unicon_core.workflow.program_data import ProgramData
from unicon_core.workflow.tick_tree import holders_of

TARGET = "joint_pos_target"


def beginning(program: ProgramData) -> Target:
    """Return where the flow of a program begins, from the present states on.

    A controller begins at its default pose with its gains; joints to which it gives no stiffness,
    such as wheels, stay where they were measured, and so do those that it does not know, with the
    robot file's gains. `pose` and `hold` begin wherever the robot is, and
    `damp` without stiffness. Of any other block it is the first command.

    Args:
        program: whose platform has been received from.

    Raises:
        Fault: what the flow raises when it is asked for its first command.
        RobotError: the robot file lacks a gain that is needed.
    """
    block = next((found for node in program.stages[Stage.FLOW] if (found := _acting(node))), None)
    robot, measured = program.robot, np.array(program.states["joint_pos"])
    if block is None or isinstance(block.tick, (Pose, Hold, Damp)):
        stiffness, damping = robot_gains(robot, "start")
        if block is not None and isinstance(block.tick, Damp):
            stiffness = np.zeros_like(stiffness)
        where = "the measured posture" + (f", where {block.name!r} begins" if block else "")
        return Target(measured, stiffness, damping, where)
    contract = controller_contract(block)
    if contract is None:
        return first_command(program)
    stiffness, damping = robot_gains(robot, "start")
    own = joint_index(contract.joints, robot.joint_names)
    for gains, key in ((stiffness, "stiffness"), (damping, "damping")):
        said = getattr(contract, key, None)  # a policy says its gains, other controllers need not
        if said is not None:
            gains[own] = said
    default = np.asarray(contract.default_joint_pos, np.float32)
    stays = np.isnan(default) | ((stiffness[own] == 0.0) & ~robot.by_position[own])
    measured[own] = np.where(stays, measured[own], default)
    return Target(measured, stiffness, damping, f"the default pose of {contract.name!r}")


def first_command(program: ProgramData) -> Target:
    """Return the first command that the flow would send from the present states on.

    The flow and the safety blocks are evaluated once, and all states and what the blocks remember
    are put back; nothing is sent. A block that declares no memory is made fresh.

    Args:
        program: whose platform has been received from; between two ticks.

    Raises:
        Fault: a block raised it.
    """
    stages, states = program.stages, program.states
    acting = [node for s in (Stage.COMMAND, Stage.FLOW, Stage.SAFETY) for node in stages[s]]
    graph = compile_graph(Zip(*acting))
    memory = Memory(holders_of(program, acting), states.buffer)
    before, snapshot = states.snapshot(), memory.take()
    try:
        graph.step()
        commands = (TARGET, "joint_stiffness", "joint_damping")
        target, stiffness, damping = (np.array(states[name]) for name in commands)
    finally:
        graph.reset()
        memory.put_back(snapshot)
        states.restore(before)  # last: blocks that are made fresh may write states
    return Target(target, stiffness, damping, "the flow's first command")


def _acting(node: Node) -> Block | None:
    """Return the block that is the first to give targets, None where none does."""
    if isinstance(node, Block):
        return node if TARGET in (*node.writes, *node.amends) else None
    if isinstance(node, Switch):
        chosen = node.index(node.selector.tick())
        if node.selector.reset is not None:
            node.selector.reset()
        return _acting(node.children[chosen])
    chooser = chooser_of(node)
    children = (child for child in children_of(node) if child is not chooser)
    return next((found for child in children if (found := _acting(child))), None)
