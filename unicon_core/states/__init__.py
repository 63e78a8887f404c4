"""States: typed NumPy arrays under global labels, in one buffer, for every block and bridge."""

from unicon_core.states.layout import Layout, Slot, StateSpec
from unicon_core.states.standard import standard_states
from unicon_core.states.states import Snapshot, States

__all__ = ["Layout", "Slot", "Snapshot", "StateSpec", "States", "standard_states"]
