"""Which runs of numbers may share a NumPy copy, and the strided views for it; for the fast path."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import as_strided

from unicon_msgs_map.codec.binding import AnyArray
from unicon_msgs_map.codec.careful import Run

__all__ = ["Grid", "address", "fuse", "grid_of", "line", "plain", "step"]


@dataclass(frozen=True)
class Grid:
    """Where the numbers of a group lie in a payload, [B].

    Attributes:
        start: of the first number.
        between: from a run to the next.
        step: from a number to the next.
    """

    start: int
    between: int
    step: int


def plain(run: Run) -> bool:
    """Tell whether NumPy's cast gives the value, with no rounding, saturation or wrapping."""
    assert run.target is not None
    assert run.primitive is not None
    wire, state = np.dtype(run.primitive.dtype), run.flat.dtype
    if wire.kind == "b" or state.kind == "b":
        return False
    if state.kind == "f":
        return True
    return run.target.conversion is None and bool(np.can_cast(wire, state, "safe"))


def fuse(runs: list[Run]) -> list[list[Run]]:
    """Group consecutive runs of equal form whose states lie at even distances."""
    groups: list[list[Run]] = []
    for run in runs:
        group = groups[-1] if groups else None
        if group is not None and _alike(group[-1], run):
            distance = address(run) - address(group[-1])
            if len(group) == 1 or distance == address(group[1]) - address(group[0]):
                group.append(run)
                continue
        groups.append([run])
    return groups


def _alike(a: Run, b: Run) -> bool:
    steps = step(a.elements), step(b.elements)
    return (
        steps[0] is not None
        and steps[0] == steps[1]
        and len(a.elements) == len(b.elements)
        and a.flat.dtype == b.flat.dtype
        and a.flat.strides == b.flat.strides
    )


def line(run: Run) -> AnyArray:
    """Return the view of a run's elements, which are evenly spaced."""
    distance = step(run.elements)
    assert distance is not None
    first = run.flat[run.elements[0] : run.elements[0] + 1]
    return as_strided(first, (len(run.elements),), (distance * run.flat.strides[0],))


def address(run: Run) -> int:
    """Return where a run's first element lies in memory."""
    return int(run.flat[run.elements[0] :].__array_interface__["data"][0])


def step(elements: tuple[int, ...]) -> int | None:
    """Return the distance of evenly spaced elements; None for others."""
    steps = {b - a for a, b in pairwise(elements)}
    return steps.pop() if len(steps) == 1 else None


def grid_of(group: list[Run]) -> Grid | None:
    """Return how the numbers of runs of equal form lie in the payload; None if unevenly."""
    steps = {step(run.offsets) for run in group}
    distances = {b.offsets[0] - a.offsets[0] for a, b in pairwise(group)} or {0}
    if len(steps) > 1 or len(distances) > 1:
        return None
    spacing = steps.pop()
    return None if spacing is None else Grid(group[0].offsets[0], distances.pop(), spacing)
