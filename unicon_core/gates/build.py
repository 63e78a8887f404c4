"""`gates_of`: the gates of a program, made of what its platform tells."""

from __future__ import annotations

import numpy as np

from unicon_base.arrays import Float32
from unicon_core.blocks.approach import Target
from unicon_core.blocks.postures import Damp, Hold, Pose, robot_gains
from unicon_core.blocks.safety.ranges import RangeStop
from unicon_core.blocks.safety.stops import TiltStop
from unicon_core.blocks.safety.stuck import ImuStop
from unicon_core.bounds import POSITION
from unicon_core.flow import Block, Node, Stage, Switch, Zip, blocks_of, children_of, compile_graph
from unicon_core.flow.nodes import chooser_of
from unicon_core.gates.data import Changing, Imu, Rate, Told
from unicon_core.gates.gate import Heeding, NoCommand, Passing, SoleCommander, StartGate, Variant
from unicon_core.memory import Memory
from unicon_core.platforms.joined import members_of
from unicon_core.platforms.platform import CountsArrivals, Prepares, ReportsVariant, SeesCommanders
from unicon_core.policies.controller import controller_contract
from unicon_core.robots import joint_index, robot_files
from unicon_core.states.standard import JOINT_STATES
from unicon_core.workflow.program_data import ProgramData
from unicon_core.workflow.tick_tree import holders_of

MARGIN = 0.05
"""How far beyond its limits a joint may be measured at the start, [rad]: encoders have offsets."""
TILT = 1.0
"""The tilt of a robot that walks, where no `tilt_stop` says one, [rad]."""
LASTING = 0.5
"""How long the reason of a stop stays that counts before it trips, [s]."""

IMU = ("base_quat", "projected_gravity", "base_ang_vel", "base_lin_acc")


def gates_of(program: ProgramData) -> list[StartGate]:
    """Return the gates of a program, each for what its platform tells.

    None where the program says so (`start: {gates: false}`), where the robot is in another part,
    and for a batch, which only simulators have.

    Args:
        program: whose platform, stages and critical blocks are there.
    """
    if not program.start.gates or not program.has_platform or program.states.num_robots is not None:
        return []
    gates = _gates(program)
    return [Passing(gate) for gate in gates] if program.platform.facts.simulated else gates


def _gates(program: ProgramData) -> list[StartGate]:
    states, robot, platform = program.states, program.robot, program.platform
    period, facts = program.period, platform.facts
    source = f"platform {facts.name!r}"
    early = (*program.stages[Stage.RECV], *program.stages[Stage.ESTIMATE])
    measured = {name for node in early for block in blocks_of(node) for name in block.writes}
    readers = {
        state: block.name
        for block in sorted(program.critical, key=lambda block: block.name)
        for state in (*block.reads, *block.amends)
        if state in facts.writes and states[state].dtype.kind == "f"
    }
    told = {name: states[name] for name in (*IMU, *JOINT_STATES) if name in measured}
    gates: list[StartGate] = []
    if readers:
        gates.append(Told(states, readers, source))
    promised = robot.transport.get("rate_hz")
    rate = float(promised) if isinstance(promised, int | float) and promised > 0 else None
    if isinstance(platform, CountsArrivals):
        gates.append(Rate(platform.arrivals, period, rate, source))
    elif "stamp_ns" in facts.writes:
        gates.append(Rate(states["stamp_ns"].item, period, rate, source))
    imu = {name: told[name] for name in IMU if name in told}
    joints = [told[name] for name in JOINT_STATES if name in told]
    if imu and joints:
        gates.append(Changing([*imu.values()], joints, told.get("joint_vel"), period))
    if imu:
        gates.append(Imu(imu, readers, period, _imu_stop(program, told)))
    if "joint_pos" in told:
        lower, upper = robot.limits(POSITION)
        beyond = np.float32(MARGIN)
        files = dict.fromkeys(path.name for path in robot_files(robot).values())
        gates.append(
            Heeding(
                "posture",
                f"every joint is within its limits, or {MARGIN} rad beyond",
                RangeStop(states, robot, {"joint_pos": (lower - beyond, upper + beyond)}),
                f"move it there by hand, calibrate its encoder, or correct {' or '.join(files)}",
            )
        )
    gates += _tilt(program, told)
    gates += _stops(program, measured)
    for _, each, own in members_of(platform, robot):
        if isinstance(each, ReportsVariant):
            gates.append(Variant(each.variant, own))
        # Behind the gates `prepare` may be what makes the robot's own controller let go.
        if isinstance(each, SeesCommanders) and not isinstance(each, Prepares):
            gates.append(SoleCommander(each.commanders))
    if program.command_bounds:
        gates.append(NoCommand(states["velocity_command"]))
    return gates


def _stops(program: ProgramData, measured: set[str]) -> list[StartGate]:
    """The workflow's own stops, as far as they look at nothing but what is measured."""
    stops = [
        block
        for block in program.stages[Stage.SAFETY]
        if isinstance(block, Block) and not isinstance(block.tick, TiltStop)
        if block.reads and measured.issuperset(block.reads) and not (block.amends or block.writes)
    ]
    return [
        Heeding(
            block.name,
            "this safety block would not trip",
            block.tick,
            "it would end the run at once",
            block.reset,
            _lasting(program),
        )
        for block in stops
    ]


def _lasting(program: ProgramData) -> int:
    return round(LASTING / program.period)


def _imu_stop(program: ProgramData, told: dict[str, Float32]) -> Heeding | None:
    needs = ("base_quat", "base_ang_vel", "projected_gravity", "joint_pos")
    if any(name not in told for name in needs):
        return None
    quat, gyro, gravity, joints = (told[name] for name in needs)
    stop = ImuStop(quat, gyro, gravity, joints, program.states["stamp_ns"], period=program.period)
    remedy = "correct the IMU's axes and signs in the driver or the map"
    return Heeding("imu_stop", "", stop, remedy, stop.reset, _lasting(program))


def _tilt(program: ProgramData, told: dict[str, Float32]) -> list[StartGate]:
    """The workflow's own `tilt_stop`, or that of a robot that walks."""
    stops = [block.tick for block in program.blocks if isinstance(block.tick, TiltStop)]
    if not stops and program.robot.walks and "projected_gravity" in told:
        stops = [TiltStop(told["projected_gravity"], angle=TILT)]
    remedy = "set the robot upright, or correct the IMU's axes"
    return [
        Heeding("tilt", "the base leans no more than it may in the run", stop, remedy)
        for stop in stops[:1]
    ]


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
    if block is None or isinstance(block.tick, Pose | Hold | Damp):
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
