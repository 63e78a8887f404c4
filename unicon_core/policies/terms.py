"""The terms of an observation, resolved against states, for the observation, tables and checks."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from unicon_base import PolicyError, RobotError, alternatives
from unicon_base.arrays import Float32, Index
from unicon_core.policies.contract import ObservationSpec, ObservationTerm, PolicyContract
from unicon_core.policies.controller import PackedStates
from unicon_core.robots import joint_index


@dataclass(frozen=True)
class TermSlice:
    """A term as it stands in one frame: its elements and the names and unit of its state.

    Attributes:
        term: of the contract.
        elements: elements of the state in its own order, shape (d,).
        start: first place in the frame.
        names: names of the elements, such as joints; may be empty.
        unit: unit of the state.
        subtract: shape (d,), unit of the state.
        scale: shape (d,).
        low, high: bounds before scaling, shape (d,); infinite where there is no clip.
    """

    term: ObservationTerm
    elements: Index
    start: int
    names: tuple[str, ...]
    unit: str
    subtract: Float32
    scale: Float32
    low: Float32
    high: Float32

    @property
    def stop(self) -> int:
        """One past the last place in the frame."""
        return self.start + self.elements.size


def term_slices(
    contract: PolicyContract,
    states: PackedStates,
    robot_joints: Sequence[str],
    spec: ObservationSpec | None = None,
) -> tuple[TermSlice, ...]:
    """Resolve the terms of an observation against states: which elements, and every number.

    Args:
        contract: the policy.
        states: the states; a state whose element names are the robot's joints is taken in policy
            order, and so is another policy's action, of the joints that this policy moves.
        robot_joints: the robot's joint order.
        spec: another observation than the contract's own.

    Raises:
        PolicyError: no such state, a joint the robot has not, or an index or number of values that
            does not fit.
    """
    slices: list[TermSlice] = []
    start = 0
    for term in (contract.observation if spec is None else spec).terms:
        label = f"policy {contract.name}: term {term.name!r}"
        if term.state not in states:
            known = alternatives(term.state, list(states))
            raise PolicyError(f"{label}: no state {term.state!r}; {known}")
        state, dtype = states.spec(term.state), states[term.state].dtype
        if dtype != np.float32:
            text = f"state {term.state!r} is {dtype}; a network takes float32 states"
            raise PolicyError(f"{label}: {text}")
        names, elements = tuple(state.names), np.arange(state.size, dtype=np.intp)
        whole = {*names} == {*robot_joints}
        own = contract.joints if whole else contract.action.joints
        if term.state != "action" and (whole or {*names} == {*own}):
            try:
                elements = joint_index(own, names)
            except RobotError as error:
                raise PolicyError(f"{label}: the robot has {error}") from error
            names = own
        subtract = 0.0 if term.subtract is None else term.subtract
        default = contract.default_joint_pos if names == contract.joints else None
        if term.index is not None:
            if max(term.index) >= elements.size:
                # Sources do not agree upon what stands where in a gait clock.
                order = f" ({', '.join(names)})" if term.state.startswith("gait_phase") else ""
                raise PolicyError(
                    f"{label}: index {max(term.index)} of state {term.state!r}, which has "
                    f"{elements.size} elements{order}; the last is {elements.size - 1}"
                )
            index = list(term.index)
            elements = elements[index]
            names = tuple(names[i] for i in index) if names else ()
            default = None if default is None else default[index]
        if isinstance(subtract, str):
            if default is None:
                raise PolicyError(
                    f"{label}: subtract {subtract} needs a joint state, and {term.state!r} has no "
                    "joint names; give numbers, or take joint_pos"
                )
            subtract = default
        low, high = (-np.inf, np.inf) if term.clip is None else term.clip
        spread = []
        for what, values in (
            ("subtract", subtract), ("scale", term.scale), ("clip", low), ("clip", high),
        ):  # fmt: skip
            array, size = np.atleast_1d(np.asarray(values, np.float32)), elements.size
            if array.size not in (1, size):
                raise PolicyError(
                    f"{label}: {what} has {array.size} values for {size} elements; give 1 or {size}"
                )
            spread.append(np.array(np.broadcast_to(array, (size,))))
        slices.append(TermSlice(term, elements, start, names, str(state.unit), *spread))
        start += elements.size
    return tuple(slices)


# Values of what most policies see, the last one of one phase; then what many do without, which is
# named where nothing else would fit.
_USUAL = (
    {"projected_gravity": 3, "base_ang_vel": 3, "velocity_command": 3, "gait_phase": 2},
    {"base_lin_vel": 3},
)


def explain_size(
    slices: Sequence[TermSlice], takes: int, joints: Collection[str], counts: Collection[int]
) -> str:
    """Return what would make the observation fit; "" where nothing or more than one thing would.

    Args:
        slices: the terms.
        takes: size of the network's input.
        joints: names of the robot's joints.
        counts: plausible numbers of joints: the robot's, the policy's, the network's.
    """
    missing = takes - sum(part.elements.size * part.term.history for part in slices)
    moved = [part for part in slices if not {*joints}.isdisjoint(part.names)]
    found = set()
    for count in counts:
        for size in {part.elements.size for part in moved} - {count}:
            alike = [part for part in moved if part.elements.size == size]
            histories = [part.term.history for part in alike]
            # Which of some terms cannot be told, and how many only where all have one history.
            many = len(alike) * missing / ((count - size) * sum(histories))
            if many == len(alike) or (many in range(1, len(alike)) and len({*histories}) == 1):
                some = "" if many == len(alike) else f"{many:g} of "
                has = f"{size} of {count}" if count > size else f"{size}"
                has += " joints" if count > size else f" joints, not {count},"
                names = ", ".join(part.term.name for part in alike)
                found.add(f"it has {has} in {some}{names}")
    frame, history = sum(part.elements.size for part in slices), 1
    if len(ages := {part.term.history for part in slices}) == 1:
        (history,) = ages
        if takes % frame == 0:
            found.add(f"it would fit with a history of {takes // frame}, and has {history}")
    seen = " ".join(part.term.state for part in slices).replace("slewed", "velocity")
    for usual in _USUAL:
        for name, size in usual.items() if usual is _USUAL[0] or not found else ():
            if name not in seen and missing == size * history:
                found.add(f"it would fit with a term of {name} ({size} values)")
    return found.pop() if len(found) == 1 else ""
