"""What is asked of any controller, by the builder of programs and by check.

A policy is one; inverse kinematics or a predictive controller stands beside it in the same way: its
tick has an attribute `contract` that says this much.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sized
from typing import Any, Protocol, TypeAlias, cast

import numpy as np

from unicon_base import WorkflowError
from unicon_base.arrays import Array
from unicon_core.flow import Block
from unicon_core.states import States, StateSpec, standard_states


class ControllerContract(Protocol):
    """What a controller says of itself; a `PolicyContract` says all of it.

    Attributes:
        name: for messages.
        period: control period in [s]; a faster program runs it every n-th tick.
        joints: the joints that it commands, length n.
        default_joint_pos: the pose that it begins with in [rad], shape (n,).
        command_ranges: `lin_vel_x`, `lin_vel_y`, `ang_vel_z` -> lowest and highest command that it
            can follow, to which the velocity command is held where it reads that.
    """

    @property
    def name(self) -> str: ...
    @property
    def period(self) -> float: ...
    @property
    def joints(self) -> tuple[str, ...]: ...
    @property
    def default_joint_pos(self) -> Array: ...
    @property
    def command_ranges(self) -> Mapping[str, tuple[float, float]]: ...


_FACTS = tuple(name for name in vars(ControllerContract) if not name.startswith("_"))


def controller_contract(block: Block) -> ControllerContract | None:
    """Return what the controller in a block says of itself, None where it is not a controller.

    Raises:
        WorkflowError: it leaves something out, or what it says does not fit together.
    """
    contract = getattr(block.tick, "contract", None)
    if contract is None:
        return None
    what = _wrong(contract)
    if not what:
        return cast(ControllerContract, contract)
    raise WorkflowError(
        f"block {block.name!r}: its contract {what}; a controller says {', '.join(_FACTS)}, "
        "the period in [s] above 0, one position in [rad] for each joint, ranges as (lowest, "
        "highest)",
        block.where or None,
    )


def _wrong(contract: Any) -> str:
    lacking = [name for name in _FACTS if not hasattr(contract, name)]
    if lacking:
        return f"does not say {', '.join(lacking)}"
    period, ranges, joints = contract.period, contract.command_ranges, contract.joints
    if not isinstance(period, int | float) or not 0.0 < period < math.inf:
        return f"says period {period!r}"
    if not isinstance(ranges, Mapping) or any(np.shape(r) != (2,) for r in ranges.values()):
        return f"says command_ranges {ranges!r}"
    if np.shape(joints) != np.shape(contract.default_joint_pos) or np.ndim(joints) != 1:
        return f"has {np.size(contract.default_joint_pos)} positions for {np.size(joints)} joints"
    return ""


class PrefixedStates:
    """A view of states where `action` means `<prefix>action` if that is declared.

    The standard states have one name for all: what bounds a command or looks at an IMU does so for
    every policy.

    Args:
        states: the states of the workflow.
        prefix: such as `walk_`.
        instead: names that mean another one, before it is prefixed.
    """

    def __init__(
        self, states: PackedStates, prefix: str, instead: Mapping[str, str] | None = None
    ) -> None:
        self._states = states
        self._prefix = prefix
        self._instead = instead or {}
        self._standard = frozenset(standard_states(["joint"]))

    def actual(self, name: str) -> str:
        """Return the name under which a state is declared."""
        name = self._instead.get(name, name)
        prefixed = f"{self._prefix}{name}"
        return prefixed if name not in self._standard and prefixed in self._states else name

    @property
    def num_robots(self) -> int | None:
        """Leading batch dimension, or None."""
        return self._states.num_robots

    def __getitem__(self, name: str) -> Array:
        return self._states[self.actual(name)]

    def __contains__(self, name: str) -> bool:
        return self.actual(name) in self._states

    def __iter__(self) -> Iterator[str]:
        return iter(self._states)

    def spec(self, name: str) -> StateSpec:
        """Return the specification of a state."""
        return self._states.spec(self.actual(name))

    def buffer_of(self, dtype: Any) -> Array:
        """Return all states of one dtype as one flat view."""
        return self._states.buffer_of(dtype)

    def offset(self, name: str) -> int:
        """Return the index of a state's first element in `buffer_of`."""
        return self._states.offset(self.actual(name))


PackedStates: TypeAlias = States | PrefixedStates
"""What is asked for: views by name, their specifications and the packed buffer."""


def prefix_of(key: str, policies: Sized) -> str:
    """Return what the names of a policy's own states begin with: nothing where it is the only one.

    Args:
        key: under `policies:` of a workflow.
        policies: all that stand there.
    """
    return f"{key}_" if len(policies) > 1 else ""
