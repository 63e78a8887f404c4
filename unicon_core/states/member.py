"""The states of one member of a robot: the same memory, of joint states its own joints alone.

A platform or a block that is built with them sees a robot of its own: what it writes are slices of
the whole, without a copy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from unicon_core.states.layout import Layout, Slot
from unicon_core.states.spec import StateSpec
from unicon_core.states.standard import BASE_STATES
from unicon_core.states.states import States

STAMP = "stamp_ns"
_OF_THE_BASE = (*BASE_STATES, "battery_charge", "battery_voltage")

_Placed = tuple[dict[str, Slot], dict[str, tuple[int, int]], int]


@dataclass(frozen=True, eq=False)
class _Within(Layout):
    """A layout whose states stand within the buffer of another one."""

    place: _Placed = field(default=({}, {}, 0), kw_only=True)

    @cached_property
    def _placed(self) -> _Placed:
        return self.place


def stamp_of(member: str) -> str:
    """Return the state of the whole that is `stamp_ns` of a member."""
    return f"{member}_{STAMP}"


def divided(layout: Layout, joint_names: Sequence[str]) -> frozenset[str]:
    """Return the states that have an element for each joint of the whole."""
    whole = tuple(joint_names)
    return frozenset(name for name, spec in layout.specs.items() if spec.names == whole)


def member_states(
    states: States,
    joint_names: Sequence[str],
    member: str,
    joints: slice,
    own_names: Sequence[str],
    *,
    base: bool,
) -> States:
    """Return the states of a member.

    Args:
        states: of the whole robot, one and no batch.
        joint_names: of the whole robot.
        member: its name.
        joints: where its joints stand.
        own_names: its joints as its robot file calls them.
        base: it has the base: IMU, battery.
    """
    layout = states.layout
    shared = divided(layout, joint_names)
    specs: dict[str, StateSpec] = {}
    slots: dict[str, Slot] = {}
    for name, spec in layout.specs.items():
        slot = layout.slots[name]
        if name in shared and spec.shape == (len(joint_names),):
            size = np.dtype(slot.dtype).itemsize
            count = joints.stop - joints.start
            initial = spec.initial
            slots[name] = Slot(slot.offset + joints.start * size, (count,), slot.dtype)
            specs[name] = replace(
                spec,
                shape=(count,),
                names=tuple(own_names),
                initial=initial[joints] if isinstance(initial, tuple) else initial,
            )
        elif name == STAMP and stamp_of(member) in layout.specs:
            slots[name], specs[name] = layout.slots[stamp_of(member)], spec
        elif name not in shared and (base or name not in _OF_THE_BASE):
            slots[name], specs[name] = slot, spec
    place = (slots, layout.sections, layout.nbytes)
    return States(_Within(specs, place=place), buffer=states.buffer)
