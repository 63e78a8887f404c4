"""Evenly spaced numbers: which arrays may share one NumPy copy, and the views for it; for codecs.

Arrays of one state buffer, such as joint_pos, joint_vel and joint_effort, lie at even distances,
and so do the sequences of one message: a two-dimensional strided view copies all of them at once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from typing import TypeVar

from numpy.lib.stride_tricks import as_strided

from unicon_msgs_map.codec.binding import AnyArray

Member = TypeVar("Member")


def step(values: Sequence[int]) -> int | None:
    """Return the distance of evenly spaced numbers; None for others."""
    steps = {b - a for a, b in pairwise(values)}
    return steps.pop() if len(steps) == 1 else None


def address(array: AnyArray) -> int:
    """Return where an array begins in memory."""
    return int(array.__array_interface__["data"][0])


def line(flat: AnyArray, elements: Sequence[int]) -> AnyArray:
    """Return the view of evenly spaced elements of a 1-D array, shape (len(elements),)."""
    distance = step(elements)
    assert distance is not None
    first = flat[elements[0] : elements[0] + 1]
    return as_strided(first, (len(elements),), (distance * flat.strides[0],))


def stack(lines: Sequence[AnyArray]) -> AnyArray:
    """Return one view of lines of equal form at even distances, shape (len(lines), n).

    Every element of it lies in one of the lines, which the caller must keep alive.
    """
    first = lines[0]
    if len(lines) == 1:
        return first
    between = address(lines[1]) - address(first)
    return as_strided(first, (len(lines), *first.shape), (between, *first.strides))


def fuse(
    members: Iterable[Member],
    form: Callable[[Member], object],
    places: Callable[[Member], Sequence[int]],
) -> list[list[Member]]:
    """Group consecutive members of equal form that lie at even distances.

    Args:
        members: in the order of their places.
        form: what two members must have alike.
        places: where a member begins in each memory that counts, [B].
    """

    def apart(a: Member, b: Member) -> list[int]:
        return [end - start for start, end in zip(places(a), places(b))]

    groups: list[list[Member]] = []
    for member in members:
        group = groups[-1] if groups else []
        even = len(group) < 2 or apart(group[-1], member) == apart(group[0], group[1])
        if group and form(group[-1]) == form(member) and even:
            group.append(member)
        else:
            groups.append([member])
    return groups
