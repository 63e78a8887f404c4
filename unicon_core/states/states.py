"""States: the one buffer and its views, for everybody who reads or writes runtime data."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from unicon_base.arrays import Array, UInt8
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
        key = np.dtype(dtype).name
        start, count = self._layout.sections.get(key, (0, 0))
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
