"""Why an observation does not have the size of the network's input, where one reason alone fits."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from unicon_core.policies.terms import TermSlice

_OFTEN = {"projected_gravity": 3, "base_ang_vel": 3, "velocity_command": 3, "gait_phase": 2}
"""Values of what most policies see, the last one of one phase."""
_SELDOM = {"base_lin_vel": 3}
"""Many policies do without: it is named where nothing else would fit."""


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
    found = {text for count in counts for text in _of_joints(moved, count, missing)}
    histories = {part.term.history for part in slices}
    frame = sum(part.elements.size for part in slices)
    history = max(histories) if len(histories) == 1 else 1
    if len(histories) == 1 and takes % frame == 0:
        found.add(f"it would fit with a history of {takes // frame}, and has {history}")
    seen = " ".join(part.term.state for part in slices).replace("slewed", "velocity")
    for usual in (_OFTEN, _SELDOM):
        for name, size in usual.items() if usual is _OFTEN or not found else ():
            if name not in seen and missing == size * history:
                found.add(f"it would fit with a term of {name} ({size} values)")
    return found.pop() if len(found) == 1 else ""


def _of_joints(parts: Sequence[TermSlice], count: int, missing: int) -> set[str]:
    """Return which terms of one size make up for what is missing if they have so many joints."""
    found = set()
    for size in {part.elements.size for part in parts} - {count}:
        alike = [part for part in parts if part.elements.size == size]
        histories = [part.term.history for part in alike]
        # Of some of them it cannot be told which, and how many only if all have the same history.
        many = len(alike) * missing / ((count - size) * sum(histories))
        if many == len(alike) or (many in range(1, len(alike)) and len({*histories}) == 1):
            some = "" if many == len(alike) else f"{many:g} of "
            has = f"{size} of {count} joints" if count > size else f"{size} joints, not {count},"
            found.add(f"it has {has} in {some}{', '.join(part.term.name for part in alike)}")
    return found
