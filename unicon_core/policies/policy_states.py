"""The states that a policy adds to the standard ones, and those that it takes and writes.

`policy_states` is for the layout of the states; the others are for the block of the policy.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from unicon_base import AnyDict, PolicyError
from unicon_base.arrays import Array
from unicon_base.located_yaml import read_yaml
from unicon_core.policies.chunks import DELAY, PREFIX, RemoteSpec
from unicon_core.policies.contract import PolicyContract
from unicon_core.policies.controller import PackedStates, PrefixedStates
from unicon_core.policies.motion.follow import MotionClock
from unicon_core.policies.networks.onnx import chained_outputs
from unicon_core.policies.observation import Observation
from unicon_core.policies.perception import HEIGHT_SCAN, HeightScan
from unicon_core.policies.phase import (
    COMMAND,
    SLEWED,
    CommandSlew,
    GaitPhase,
    RollPitchYaw,
    derived_states,
)
from unicon_core.states import States, StateSpec, standard_states

_ROWS: AnyDict = read_yaml(Path(__file__).with_name("states.yaml")).value


def _state(name: str, names: Sequence[str] = (), size: int = 0) -> StateSpec:
    """Return the row of a state as a specification, of so many elements as it has names.

    Args:
        name: of the state.
        names: of its elements, unless the row says them.
        size: number of elements without names; one number without an axis if neither is given.
    """
    row = {"names": names, **_ROWS[name]}
    size = len(row["names"]) or size
    return StateSpec.from_dict({"shape": [size] if size else [], **row})


TIMES = {name: _state(name) for name in ("action_round_trip", "action_inference")}
"""States of a policy at a server that hold wall-clock times; no replay repeats them."""


def policy_states(
    contract: PolicyContract,
    robot_joints: Sequence[str],
    extra: Mapping[str, StateSpec] | None = None,
    *,
    prefix: str = "",
) -> dict[str, StateSpec]:
    """Return the states to declare for a policy: `observation`, `action`, and the gait phase.

    Args:
        contract: the policy.
        robot_joints: the robot's joint order, which decides what is taken in policy order.
        extra: further states of the workflow that terms may name.
        prefix: put before the names, so that a workflow can hold several policies; the policy
            block takes the same.

    Raises:
        PolicyError: a term takes a state that is neither standard, nor extra, nor the policy's own.
    """
    own = states_of(contract)
    if contract.terms:
        specs = {**standard_states(robot_joints), **(extra or {}), **own}
        size = Observation(contract, States(specs), robot_joints).size
        own["observation"] = StateSpec((size,), description="the network's input")
    return {f"{prefix}{name}": spec for name, spec in own.items()}


def states_of(contract: PolicyContract) -> dict[str, StateSpec]:
    """Return the states of a policy without a prefix, but for `observation`."""
    joints = contract.action.joints
    states = {"action": _state("action", joints), **derived_states(contract)}
    if contract.child is not None:
        states["action_age"] = _state("action_age")
    if contract.chunk is not None:
        for name, size in ((PREFIX, contract.chunk.size * len(joints)), (DELAY, 1)):
            if name in contract.inputs:
                states[name] = _state(name, size=size)
    if isinstance(contract.child, RemoteSpec):
        states |= TIMES
    if contract.command is not None:
        command = standard_states(joints)[COMMAND]
        states[SLEWED] = replace(command, description="velocity_command as the policy sees it")
    if contract.phase is not None:
        count = range(len(contract.phase.offsets))
        sines, cosines = (tuple(f"{what}_{k}" for k in count) for what in ("sin", "cos"))
        for suffix, parts in (("_sin", sines), ("_cos", cosines), ("", sines + cosines)):
            states[f"gait_phase{suffix}"] = _state(f"gait_phase{suffix}", parts)
    if contract.height_scan is not None:
        states[HEIGHT_SCAN] = contract.height_scan.state()
    for name, image in contract.images.items():
        states |= image.states(name)
    if contract.motion is not None:
        followed = [name for name in _ROWS if name.startswith("motion_")]
        if contract.motion.duration is not None:
            followed = ["motion_time", "motion_phase"]
        for name in followed:
            names = contract.joints if name.startswith("motion_joint_") else ()
            size = 2 * len(contract.joints) if name == "motion_command" else 0
            states[name] = _state(name, names, size)
    extra, more = contract.action.extra, {**contract.outputs}
    action = more.pop("action", "")
    if extra in {*states, *standard_states(("joint",)), "observation"}:
        text = f"action.extra is {extra!r}, a state that is there; give another name"
        raise PolicyError(f"policy {contract.name}: {text}")
    if contract.is_onnx and (extra is not None or more):
        tensors = chained_outputs(contract)
        made = tensors.get(action)
        if extra is not None and made is not None and isinstance(made.width, int):
            size = max(made.width - len(joints), 1)
            states[extra] = StateSpec((size,), description="further outputs")
        for name, output in more.items():
            size = tensors[output].size if output in tensors else 1
            names = contract.joints if name.startswith("motion_joint_") else ()
            names = names if len(names) == size else ()
            states[name] = StateSpec((size,), names=names, description=f"output {output}")
    if contract.motion is None and {"motion_joint_pos", "motion_joint_vel"} <= {*states}:
        size = states["motion_joint_pos"].size + states["motion_joint_vel"].size
        states["motion_command"] = _state("motion_command", size=size)
    return states


def own_states(
    contract: PolicyContract, states: PackedStates, prefix: str
) -> tuple[PackedStates, CommandSlew | None]:
    """Return the states as the policy sees them, and what limits its command.

    Args:
        contract: the policy.
        states: of the workflow.
        prefix: of the policy's own states, or "".
    """
    if contract.command is None:
        return (PrefixedStates(states, prefix) if prefix else states), None
    slew = CommandSlew(contract.command, PrefixedStates(states, prefix), contract.period)
    return PrefixedStates(states, prefix, {COMMAND: SLEWED}), slew


def fed_back(contract: PolicyContract, states: PackedStates) -> list[Array]:
    """Return the outputs that a policy sees in its next tick: its action, and states it reads."""
    read = contract.seen
    phase = contract.phase
    read |= {part.state for part in (phase and phase.rate, phase and phase.shift) if part}
    names = ["action", *(name for name in contract.outputs if name in read and name != "action")]
    names += [contract.action.extra] if contract.action.extra else []
    return [states[name] for name in names if name in states]


def reads_writes(
    contract: PolicyContract,
    states: PackedStates,
    before: Sequence[RollPitchYaw | CommandSlew | GaitPhase | HeightScan],
    tracker: MotionClock | None,
    targets: Sequence[str],
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return names as they are declared: what the policy takes from others, and what it writes.

    Args:
        contract: the policy.
        states: as the policy sees them.
        before: what runs before the network.
        tracker: what follows a motion, or None.
        targets: command states that are written.
    """
    own = ["observation", "action", PREFIX, DELAY, *derived_states(contract)]
    own += [name for part in before for name in part.writes]
    own += [*contract.outputs, "motion_command", contract.action.extra or "action"]
    read = [name for part in before for name in part.reads]
    if tracker is not None:
        own += tracker.writes
        read += tracker.reads
    read += [term.state for term in contract.terms if "observation" in contract.inputs]
    read += [name for name in contract.inputs if name != "observation" and name in states]
    read += ["joint_pos"] if contract.action.kinds else []

    def actual(name: str) -> str:
        return states.actual(name) if isinstance(states, PrefixedStates) else name

    own = [actual(name) for name in own if name in states]
    writes = tuple(dict.fromkeys([*own, *targets]))
    reads = [*map(actual, read), *([COMMAND] if contract.command is not None else [])]
    return tuple(name for name in dict.fromkeys(reads) if name not in writes), writes
