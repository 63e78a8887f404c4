"""Groups: some states under a layout of their own, copied from and to a workflow's states.

group = subset(states.layout, ("joint_pos", "joint_vel"))
copies = Copies(states, group, memory)     # memory: group.nbytes bytes, anywhere
copies.pack()                              # states -> memory

The states of a member of a robot are such a part, too: a platform or a block that is built with
them sees a robot of its own, and writes slices of the whole without a copy.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from unicon_base.errors import StateError
from unicon_core.states.layout import Layout, Slot, StateSpec
from unicon_core.states.standard import BASE_STATES, COMMAND_STATES, GAIN_SCALE, GAIN_SCALE_SPEC
from unicon_core.states.states import States

MEASURED, COMMAND = "measured", "command"
"""Names of a workflow's groups."""

Groups = Mapping[str, Layout]
"""Name of each group to its layout."""


def subset(layout: Layout, names: Iterable[str]) -> Layout:
    """Return the layout of some states of another one, in that one's order.

    Raises:
        StateError: a state is not there.
    """
    wanted = set(names)
    for name in sorted(wanted - set(layout.specs)):
        raise StateError(f"no state {name!r} for a group; there are {', '.join(layout.specs)}")
    chosen = {name: spec for name, spec in layout.specs.items() if name in wanted}
    return Layout(chosen, layout.num_robots)


def groups_of(layout: Layout) -> dict[str, Layout]:
    """Return the groups of a workflow's states: `measured`, and `command` which `send` releases.

    They are two, since nobody outside may see a command before safety has. A group without states
    is left out, and so is the state that a host adds for its records: groups do not depend on who
    hosts a workflow.
    """
    others = [name for name in layout.specs if name not in COMMAND_STATES]
    if layout.specs.get(GAIN_SCALE) == GAIN_SCALE_SPEC:
        others.remove(GAIN_SCALE)
    chosen = {
        MEASURED: others,
        COMMAND: [name for name in layout.specs if name in COMMAND_STATES],
    }
    return {group: subset(layout, names) for group, names in chosen.items() if names}


def groups_json(groups: Groups) -> str:
    """Return groups as canonical JSON; `groups_from_json` reads it back."""
    named = {name: json.loads(layout.to_json()) for name, layout in groups.items()}
    return json.dumps(named, separators=(",", ":"))


def groups_from_json(text: str) -> dict[str, Layout]:
    """Read groups back.

    Raises:
        StateError: the text does not describe groups.
    """
    try:
        return {n: Layout.from_json(json.dumps(g)) for n, g in json.loads(text).items()}
    except (AttributeError, RecursionError, ValueError) as error:
        raise StateError(f"not a description of groups of states: {error}") from error


def groups_hash(groups: Groups) -> str:
    """Return SHA-256 over the canonical JSON: equal exactly when all bytes fit."""
    return hashlib.sha256(groups_json(groups).encode()).hexdigest()


def difference(mine: Layout, theirs: Layout) -> str:
    """Return the first state in which two layouts differ, in words; "" where they do not."""
    if mine == theirs:
        return ""
    if mine.num_robots != theirs.num_robots:
        here, there = mine.num_robots or "none", theirs.num_robots or "none"
        return f"num_robots is {here} here and {there} there"
    for name, spec in mine.specs.items():
        other = theirs.specs.get(name)
        if other is None:
            return f"state {name!r} is only here"
        ours, others = spec.to_dict(), other.to_dict()
        for key, value in ours.items():
            if json.dumps(value) != json.dumps(others[key]):  # so that NaN is NaN, and 1 not 1.0
                return f"state {name!r}: {key} is {value!r} here and {others[key]!r} there"
    for name in theirs.specs:
        if name not in mine.specs:
            return f"state {name!r} is only there"
    return "the states stand in another order"


# What must be the same for bytes to mean the same; descriptions and initial values may differ.
_MEANING = ("shape", "dtype", "unit", "frame", "names")


class Copies:
    """Copies a group's states to and from its packed bytes, in as few pieces as they stand in.

    Attributes:
        pairs: pieces of the packed bytes, and of the states' buffer; assign one to the other.

    Args:
        states: which have all of the group's states, of the same shape, type, unit, frame and
            element names.
        group: layout of the packed bytes.
        memory: the packed bytes, writable, `group.nbytes` long.

    Raises:
        StateError: a state is absent, or another one here.
    """

    def __init__(self, states: States, group: Layout, memory: memoryview) -> None:
        pieces: list[list[int]] = []  # start in the states' buffer, start in the group, length
        for name, slot in sorted(group.slots.items(), key=lambda item: item[1].offset):
            here = states.layout.slots.get(name)
            if here is None or here.shape != slot.shape or _differ(states.layout, group, name):
                mine = subset(states.layout, [name] if here else [])
                told = difference(mine, subset(group, [name]))
                raise StateError(f"the group does not fit: {told}")
            last = pieces[-1] if pieces else None
            if last and last[0] + last[2] == here.offset and last[1] + last[2] == slot.offset:
                last[2] += slot.nbytes
            else:
                pieces.append([here.offset, slot.offset, slot.nbytes])
        buffer = states.buffer.data
        self.pairs = tuple(
            (memory[there : there + length], buffer[here : here + length])
            for here, there, length in pieces
        )

    def pack(self) -> None:
        """Copy the states into the packed bytes."""
        for packed, state in self.pairs:
            packed[:] = state


def _differ(mine: Layout, theirs: Layout, name: str) -> bool:
    ours, others = mine.specs[name], theirs.specs[name]
    return any(getattr(ours, key) != getattr(others, key) for key in _MEANING)


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
