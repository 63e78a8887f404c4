"""The terms of an observation, resolved against states, for the observation, tables and checks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from unicon_base.arrays import Float32, Index
from unicon_base.errors import PolicyError, RobotError, alternatives
from unicon_core.policies.contract import ObservationSpec, ObservationTerm, PolicyContract
from unicon_core.policies.prefixed import PackedStates
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
            order.
        robot_joints: the robot's joint order.
        spec: another observation than the contract's own.

    Raises:
        PolicyError: no such state, a joint the robot has not, or an index or number of values that
            does not fit.
    """
    spec = contract.observation if spec is None else spec
    slices: list[TermSlice] = []
    start = 0
    for term in spec.terms:
        label = f"policy {contract.name}: term {term.name!r}"
        if term.state not in states:
            known = alternatives(term.state, list(states))
            raise PolicyError(f"{label}: no state {term.state!r}; {known}")
        state = states.spec(term.state)
        view = states[term.state]
        if view.dtype != np.float32:
            raise PolicyError(
                f"{label}: state {term.state!r} is {view.dtype}; a network takes float32 states"
            )
        names: tuple[str, ...] = tuple(state.names)
        elements = np.arange(state.size, dtype=np.intp)
        if names == tuple(robot_joints) and term.state != "action":
            try:
                elements = joint_index(contract.joints, names)
            except RobotError as error:
                raise PolicyError(f"{label}: the robot has {error}") from error
            names = contract.joints
        default = contract.default_joint_pos if names == contract.joints else None
        if term.index is not None:
            if max(term.index) >= elements.size:
                raise PolicyError(
                    f"{label}: index {max(term.index)} of state {term.state!r}, which has "
                    f"{elements.size} elements{_order_of(term.state, names)}; the last is "
                    f"{elements.size - 1}"
                )
            index = list(term.index)
            elements = elements[index]
            names = tuple(names[i] for i in index) if names else ()
            default = None if default is None else default[index]
        size = elements.size
        subtract = _subtract(label, term, size, default)
        low, high = (-np.inf, np.inf) if term.clip is None else term.clip
        slices.append(
            TermSlice(
                term,
                elements,
                start,
                names,
                str(state.unit),
                subtract,
                _spread(label, "scale", term.scale, size),
                _spread(label, "clip", low, size),
                _spread(label, "clip", high, size),
            )
        )
        start += size
    return tuple(slices)


def _order_of(state: str, names: Sequence[str]) -> str:
    """What stands where in a gait clock, whose order sources do not agree upon."""
    return f" ({', '.join(names)})" if state.startswith("gait_phase") else ""


def _subtract(label: str, term: ObservationTerm, size: int, default: Float32 | None) -> Float32:
    if not isinstance(term.subtract, str):
        return _spread(label, "subtract", 0.0 if term.subtract is None else term.subtract, size)
    if default is None:
        raise PolicyError(
            f"{label}: subtract {term.subtract} needs a joint state, and {term.state!r} has no "
            "joint names; give numbers, or take joint_pos"
        )
    return np.array(default, dtype=np.float32)


def _spread(label: str, what: str, values: Any, size: int) -> Float32:
    array = np.atleast_1d(np.asarray(values, dtype=np.float32))
    if array.size not in (1, size):
        raise PolicyError(
            f"{label}: {what} has {array.size} values for {size} elements; give 1 or {size}"
        )
    return np.array(np.broadcast_to(array, (size,)))
