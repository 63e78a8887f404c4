"""States: the one buffer and its views, for everybody who reads or writes runtime data.

States that stand together in the buffer are one view, and are looked at within bounds at once: 254
numbers of a G1, of several states and safety blocks, take 2.6 µs, where six comparisons take 9.
"""

from __future__ import annotations

import json
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike

from unicon_base.arrays import Array, Index, UInt8
from unicon_base.errors import StateError, alternatives
from unicon_core.states.layout import ALIGNMENT, Layout, StateSpec

_MAGIC = b"UNICONST1\n"


class UnknownStateError(StateError, AttributeError):
    """No state of that name; an AttributeError too, so that `hasattr(states, name)` works."""


@dataclass(frozen=True)
class Snapshot:
    """All states at one moment: the buffer's bytes and the hash of the layout they fit."""

    layout_hash: str
    data: bytes


def aligned_buffer(nbytes: int) -> UInt8:
    """Return a zeroed byte array of `nbytes`, its first byte on a 64-byte boundary."""
    raw = np.zeros(nbytes + ALIGNMENT, dtype=np.uint8)
    start = -raw.ctypes.data % ALIGNMENT
    return raw[start : start + nbytes]


class States:
    """Typed arrays under global labels, all views into one buffer.

    `states["joint_pos"]` and `states.joint_pos` give the same view, which stays valid for life:
    writing it publishes, reading it gets the latest value. `states.joint_pos = x` copies into the
    view. With `num_robots` set, every view has that leading axis.

    Args:
        layout: a Layout, or a mapping of names to specifications.
        num_robots: leading batch dimension, if `layout` is a mapping.
        buffer: memory of a storage backend, uint8 of `layout.nbytes`; own memory if None. A given
            buffer is used as it is, without a reset.

    Raises:
        StateError: a wrong specification, or a buffer of another length.
    """

    __slots__ = ("_buffer", "_initial", "_layout", "_views")

    _layout: Layout
    _buffer: UInt8
    _views: dict[str, Array]
    _initial: UInt8

    def __init__(
        self,
        layout: Layout | Mapping[str, StateSpec],
        num_robots: int | None = None,
        *,
        buffer: UInt8 | None = None,
    ) -> None:
        if not isinstance(layout, Layout):
            layout = Layout(layout, num_robots)
        if buffer is not None and (buffer.dtype != np.uint8 or buffer.size != layout.nbytes):
            raise StateError(
                f"the buffer has {buffer.size} elements of {buffer.dtype} and the layout needs "
                f"{layout.nbytes} of uint8; build both sides from one layout (compare Layout.hash)"
            )
        for name in layout.specs:
            if name in _MEMBERS:
                raise StateError(
                    f"a state cannot be named {name!r}, which is a member of States; rename it"
                )
        own = aligned_buffer(layout.nbytes) if buffer is None else buffer
        views: dict[str, Array] = {}
        for name, slot in layout.slots.items():
            part = own[slot.offset : slot.offset + slot.nbytes]
            views[name] = part.view(slot.dtype).reshape(slot.shape)
        initial = aligned_buffer(layout.nbytes)
        for name, slot in layout.slots.items():
            spec = layout.specs[name]
            value = np.asarray(spec.initial, dtype=slot.dtype)
            part = initial[slot.offset : slot.offset + slot.nbytes].view(slot.dtype)
            part.reshape(slot.shape)[...] = value.reshape(spec.shape) if value.ndim else value
        set_attribute = object.__setattr__  # our own __setattr__ writes into views
        set_attribute(self, "_buffer", own)
        set_attribute(self, "_initial", initial)
        set_attribute(self, "_layout", layout)
        set_attribute(self, "_views", views)
        if buffer is None:
            self.reset()

    @property
    def layout(self) -> Layout:
        """The layout: names, specifications, places, hash."""
        return self._layout

    @property
    def num_robots(self) -> int | None:
        """Leading batch dimension, or None."""
        return self._layout.num_robots

    @property
    def buffer(self) -> UInt8:
        """The whole buffer, uint8, shape (layout.nbytes,)."""
        return self._buffer

    def __getitem__(self, name: str) -> Array:
        try:
            return self._views[name]
        except KeyError:
            known = alternatives(name, self._views)
            raise UnknownStateError(f"no state {name!r}; {known}") from None

    def __setitem__(self, name: str, value: Any) -> None:
        self[name][...] = value

    def __getattr__(self, name: str) -> Array:
        if name.startswith("__"):
            raise AttributeError(name)
        return self[name]

    def __setattr__(self, name: str, value: Any) -> None:
        self[name] = value

    def __contains__(self, name: object) -> bool:
        return name in self._views

    def __iter__(self) -> Iterator[str]:
        return iter(self._views)

    def __len__(self) -> int:
        return len(self._views)

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self._views]

    def __repr__(self) -> str:
        batch = "" if self.num_robots is None else f" x {self.num_robots} robots"
        return f"States({len(self)} states{batch}, {self._layout.nbytes} bytes)"

    def spec(self, name: str) -> StateSpec:
        """Return the specification of a state.

        Raises:
            StateError: no such state; the message lists those that exist.
        """
        self[name]
        return self._layout.specs[name]

    def buffer_of(self, dtype: DTypeLike) -> Array:
        """Return all states of one dtype as one flat view, shape (total elements,)."""
        start, count = self._layout.sections.get(np.dtype(dtype).name, (0, 0))
        return self._buffer[start : start + count * np.dtype(dtype).itemsize].view(dtype)

    def offset(self, name: str) -> int:
        """Return the index of a state's first element in `buffer_of(its dtype)`."""
        self[name]
        slot = self._layout.slots[name]
        return (slot.offset - self._layout.sections[slot.dtype][0]) // np.dtype(slot.dtype).itemsize

    def reset(self) -> None:
        """Set every state to its initial value, in one copy."""
        self._buffer[:] = self._initial

    def snapshot(self) -> Snapshot:
        """Return all states as they are now, in one copy."""
        return Snapshot(self._layout.hash, self._buffer.tobytes())

    def restore(self, snapshot: Snapshot) -> None:
        """Set all states as they were, in one copy.

        Raises:
            StateError: the snapshot is of another layout.
        """
        if snapshot.layout_hash != self._layout.hash:
            raise StateError(
                f"the snapshot is of layout {snapshot.layout_hash[:12]} and these states are of "
                f"{self._layout.hash[:12]}; restore it where it was taken"
            )
        self._buffer[:] = np.frombuffer(snapshot.data, dtype=np.uint8)

    def save(self, path: str | Path) -> None:
        """Write a self-describing file: layout and bytes; `States.load` reads it anywhere."""
        header = self._layout.to_json().encode()
        size = len(header).to_bytes(8, "little")
        Path(path).write_bytes(_MAGIC + size + header + self._buffer.tobytes())

    @classmethod
    def load(cls, path: str | Path) -> States:
        """Read a file of `save`, without the program that wrote it.

        Raises:
            StateError: no such file, or it is truncated or of another kind.
        """
        try:
            data = Path(path).read_bytes()
        except OSError as error:
            raise StateError(f"cannot read states from {path}: {error.strerror}") from error
        start = len(_MAGIC) + 8
        size = int.from_bytes(data[len(_MAGIC) : start], "little")
        if not data.startswith(_MAGIC) or len(data) < start + size:
            raise StateError(f"{path} is not a state file; write one with States.save")
        layout = Layout.from_json(data[start : start + size].decode())
        if len(data) != start + size + layout.nbytes:
            raise StateError(f"{path} is truncated; write it again with States.save")
        states = cls(layout)
        states.buffer[:] = np.frombuffer(data, dtype=np.uint8, offset=start + size)
        return states

    def to_json(self) -> str:
        """Return names, specifications and present values as JSON, for people and tools."""
        values = {
            name: {**self._layout.specs[name].to_dict(), "value": view.tolist()}
            for name, view in self._views.items()
        }
        return json.dumps({"layout": self._layout.hash, "states": values})


# Names that attribute access would not find as states.
_MEMBERS = frozenset(name for name in dir(States) if not name.startswith("__"))


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
