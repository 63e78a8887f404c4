"""The memory of an exported controller: many arrays in one piece, as C++ finds them."""

from __future__ import annotations

import ctypes
from collections.abc import Callable

import numpy as np

from unicon_base.arrays import Array, UInt8
from unicon_base.errors import WorkflowError
from unicon_core.states import States
from unicon_core.states.layout import ALIGNMENT


class Arena:
    """Arrays in one piece of memory, each as far from those that it shares bytes with as before.

    Args:
        states: lie at its beginning.
        arrays: that follow.

    Attributes:
        nbytes: length of all.
    """

    def __init__(self, states: States, arrays: list[Array]) -> None:
        self._keep = states, arrays
        spans = sorted(map(_span, [states.buffer, *arrays]))
        joined: list[list[int]] = []
        for first, last in spans:
            if joined and first < joined[-1][1]:
                joined[-1][1] = max(joined[-1][1], last)
            else:
                joined.append([first, last])
        begin, _ = _span(states.buffer)
        self._places: list[tuple[int, int, int]] = []  # first, last, offset
        self.nbytes = 0
        for first, last in sorted(joined, key=lambda each: each[0] != begin):
            at = self.nbytes + (first - begin - self.nbytes) % ALIGNMENT
            self._places.append((first, last, at))
            self.nbytes = at + last - first
        self.nbytes += -self.nbytes % 8
        self._memories = [
            np.ctypeslib.as_array((ctypes.c_uint8 * (last - first)).from_address(first))
            for first, last, _ in self._places
        ]

    def at(self, array: Array) -> str:
        """Return where an array begins, in C++.

        Raises:
            StopIteration: it does not lie here.
        """
        where, _ = _span(array)
        offset = next(at + where - f for f, last, at in self._places if f <= where < last)
        return f"arena.memory + {offset}"

    def image(self) -> str:
        """Return all bytes as they are now, as the definition of `IMAGE`."""
        data = np.zeros(self.nbytes, np.uint8)
        for (first, last, at), memory in zip(self._places, self._memories):
            data[at : at + last - first] = memory
        words = ", ".join(map(hex, data.view(np.uint64).tolist()))
        return f"static const uint64_t IMAGE[] = {{{words}}};"

    def effect(self, function: Callable[[], object], name: str) -> str:
        """Return statements that write what a function writes, whatever there was before.

        Raises:
            WorkflowError: that depends on what there was.
        """
        before = np.concatenate(self._memories)
        fill = np.random.default_rng(0).integers(0, 256, before.size, np.uint8)
        after = []
        for values in (fill, ~fill):
            self._put(values)
            try:
                function()
                after.append(np.concatenate(self._memories))
            finally:
                self._put(before)
        written = (after[0] != fill) | (after[1] != ~fill)
        if (after[0] != after[1])[written].any():
            raise WorkflowError(
                f"{name} depends on memory, which C++ does not repeat; leave it out"
            )
        offsets = np.concatenate([np.arange(at, at + e - f) for f, e, at in self._places])[written]
        values = after[0][written]
        lines = []
        for run in np.split(np.arange(values.size), np.flatnonzero(np.diff(offsets) != 1) + 1):
            if run.size:
                said = ", ".join(map(str, values[run].tolist()))
                lines.append(
                    f"{{ static const uint8_t x[] = {{{said}}}; "
                    f"__builtin_memcpy(arena.memory + {offsets[run[0]]}, x, sizeof x); }}"
                )
        return "\n".join(lines)

    def _put(self, values: UInt8) -> None:
        at = 0
        for memory in self._memories:
            memory[...] = values[at : at + memory.size]
            at += memory.size


def _span(array: Array) -> tuple[int, int]:
    """Return the addresses of an array's first byte and behind its last one."""
    first = array.__array_interface__["data"][0]
    reach = sum((n - 1) * stride for n, stride in zip(array.shape, array.strides))
    return first, first + reach + array.itemsize
