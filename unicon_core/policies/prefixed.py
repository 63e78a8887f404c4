"""States as one policy of several sees them: its own states carry a prefix, the others do not."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sized
from typing import Any, TypeAlias

from unicon_base.arrays import Array
from unicon_core.states import States, StateSpec, standard_states


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
