"""States that stand together in the buffer: as one view, and looked at within bounds.

Bounds of several states, and of several safety blocks, are compared at once: 254 numbers of a G1
take 2.6 µs, where six comparisons of their own take 9.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from unicon_base.arrays import Array, Index
from unicon_core.states.layout import Layout
from unicon_core.states.states import States


def stacked(views: Sequence[Array]) -> Array | None:
    """Return views of one shape as one read-only view, shape (len(views), …); None where it cannot.

    The standard command states stand back to back: one copy of all five then takes 0.4 µs and five
    copies take 1.5.
    """
    first = views[0]
    starts = [view.__array_interface__["data"][0] for view in views]
    step = starts[1] - starts[0] if len(views) > 1 else first.nbytes
    alike = len({(view.dtype, view.shape, view.strides) for view in views}) == 1
    if not alike or step <= 0 or starts != [starts[0] + i * step for i in range(len(views))]:
        return None
    shape, strides = (len(views), *first.shape), (step, *first.strides)
    return np.lib.stride_tricks.as_strided(first, shape, strides, writeable=False)


def flat(views: Sequence[Array]) -> list[Array]:
    """Return contiguous views flat, one after the other: all as one where they stand back to back.

    Their shapes may differ. One product of 60 numbers with itself takes 0.5 µs and five of 12 take
    1.9.
    """
    flats = [view.reshape(-1) for view in views]
    starts = [view.__array_interface__["data"][0] for view in flats]
    ends = [start + view.nbytes for start, view in zip(starts, flats)]
    if starts[1:] != ends[:-1] or len({view.dtype for view in flats}) > 1:
        return flats
    size = (sum(view.size for view in flats),)
    return [np.lib.stride_tricks.as_strided(flats[0], size, writeable=False)]


def spans(layout: Layout, names: Container[str]) -> list[slice]:
    """Return where states stand in the buffer, in bytes; as one where they stand back to back."""
    found: list[slice] = []
    for slot in sorted(
        (slot.offset, slot.nbytes) for name, slot in layout.slots.items() if name in names
    ):
        if found and found[-1].stop == slot[0]:
            found[-1] = slice(found[-1].start, sum(slot))
        else:
            found.append(slice(slot[0], sum(slot)))
    return found


def places(view: Array, packed: Array) -> Index | None:
    """Return the place of each element of a view in the packed buffer, or None if outside."""
    start = view.__array_interface__["data"][0] - packed.__array_interface__["data"][0]
    if view.dtype != packed.dtype or start % packed.itemsize:
        return None
    found: Index = np.array(start // packed.itemsize, dtype=np.intp)
    for length, stride in zip(view.shape, view.strides):
        if stride % packed.itemsize:
            return None
        found = found[..., None] + np.arange(length) * (stride // packed.itemsize)
    inside = found.size and found.min() >= 0 and found.max() < packed.size
    return found if inside else None


GAP = 64
"""So many numbers that nobody asked for are compared along rather than apart: 64 take 0.1 µs."""


class Range(NamedTuple):
    """What a view has to lie in; NaN lies in no range.

    Attributes:
        view: a state or a part of one, of any shape.
        lower: lowest allowed values, broadcast to the view.
        upper: highest allowed values.
    """

    view: Array
    lower: Any
    upper: Any


class Screen:
    """Tells whether all of some ranges hold; of an element that is named twice both count.

    Args:
        states: whose views the ranges have.
        ranges: what has to hold.
    """

    def __init__(self, states: States, ranges: Iterable[Range]) -> None:
        pieces = [piece for dtype in _by_dtype(ranges) for piece in _pieces(states, *dtype)]
        self._holds = np.ones((2, sum(values.size for values, _, _ in pieces)), np.bool_)
        self._compared = []
        start = 0
        for values, lower, upper in pieces:
            above, below = self._holds[:, start : start + values.size]
            start += values.size
            self._compared.append((values, lower, above, upper, below))

    def __call__(self) -> bool:
        """Return whether every element lies within its bounds."""
        for values, lower, above, upper, below in self._compared:
            np.greater_equal(values, lower, above)
            np.less_equal(values, upper, below)
        return 0 not in self._holds.tobytes()  # 0.2 µs; `all` takes 2


def _by_dtype(ranges: Iterable[Range]) -> Iterator[tuple[np.dtype[Any], list[Range]]]:
    listed = list(ranges)
    for dtype in dict.fromkeys(each.view.dtype for each in listed):
        yield dtype, [each for each in listed if each.view.dtype == dtype]


def _pieces(
    states: States, dtype: np.dtype[Any], ranges: list[Range]
) -> Iterator[tuple[Array, Array, Array]]:
    """Yield stretches of the buffer of a type, each with its lower and its upper bounds."""
    packed = states.buffer_of(dtype)
    lowest, highest = (-np.inf, np.inf) if dtype.kind == "f" else _ends(dtype)
    lower, upper = np.full(packed.size, lowest, dtype), np.full(packed.size, highest, dtype)
    asked = np.zeros(packed.size, np.bool_)
    for view, low, high in ranges:
        where = places(view, packed)
        if where is None:
            raise ValueError("a range is not of these states")
        np.maximum.at(lower, where, np.broadcast_to(low, view.shape).astype(dtype))
        np.minimum.at(upper, where, np.broadcast_to(high, view.shape).astype(dtype))
        asked[where] = True
    found = np.flatnonzero(asked)
    for run in np.split(found, np.flatnonzero(np.diff(found) > GAP) + 1):
        stretch = slice(run[0], run[-1] + 1)
        yield packed[stretch], lower[stretch], upper[stretch]


def _ends(dtype: np.dtype[Any]) -> tuple[int, int]:
    return int(np.iinfo(dtype).min), int(np.iinfo(dtype).max)
