"""Which states a policy takes and writes, by the names under which they are declared."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

from numpy.typing import NDArray

from unicon_core.policies.command_slew import COMMAND, SLEWED, CommandSlew
from unicon_core.policies.contract import PolicyContract
from unicon_core.policies.prefixed import PackedStates, PrefixedStates


class Part(Protocol):
    """What runs before the network: the slew of the command, the gait clock, the motion."""

    @property
    def reads(self) -> Sequence[str]: ...
    @property
    def writes(self) -> Sequence[str]: ...
    def __call__(self) -> object: ...


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


def in_order(*parts: Part | None) -> Callable[[], object] | None:
    """Return what calls those that are there one after the other; None where none is."""
    there = [part for part in parts if part is not None]
    if len(there) < 2:
        return there[0] if there else None

    def all_of_them() -> None:
        for part in there:
            part()

    return all_of_them


def fed_back(contract: PolicyContract, states: PackedStates) -> list[NDArray[Any]]:
    """Return the outputs that a policy sees in its next tick: its action, and states it reads."""
    read = {*contract.inputs, *(term.state for term in contract.terms)}
    names = ["action", *(name for name in contract.outputs if name in read and name != "action")]
    return [states[name] for name in names if name in states]


def reads_writes(
    contract: PolicyContract,
    states: PackedStates,
    parts: Sequence[Part | None],
    targets: Sequence[str],
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return names as they are declared: what the policy takes from others, and what it writes.

    Args:
        contract: the policy.
        states: as the policy sees them.
        parts: what runs before the network; last what follows a motion, or None.
        targets: command states that are written.
    """
    there = [part for part in parts if part is not None]
    *before, follows = parts
    own = [name for name in ("observation", "action") if name in states]
    own += [name for part in before if part is not None for name in part.writes]
    own += [name for name in contract.outputs if name in states and name != "action"]
    own += ["motion_command"] if "motion_command" in states else []
    own += follows.writes if follows is not None else ()
    read = [name for part in there for name in part.reads if not isinstance(part, CommandSlew)]
    read += [term.state for term in contract.terms if "observation" in contract.inputs]
    read += [name for name in contract.inputs if name != "observation" and name in states]
    read += ["joint_pos"] if contract.action.kinds else []

    def actual(name: str) -> str:
        return states.actual(name) if isinstance(states, PrefixedStates) else name

    writes = tuple(dict.fromkeys([*map(actual, own), *targets]))
    reads = [*map(actual, read), *([COMMAND] if contract.command is not None else [])]
    return tuple(name for name in dict.fromkeys(reads) if name not in writes), writes
