"""The memory of an exported controller: many arrays in one piece, as C++ finds them."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence

import numpy as np

from unicon_base.arrays import Array, UInt8
from unicon_base.errors import WorkflowError
from unicon_core.states.layout import ALIGNMENT


class Arena:
    """Places for arrays, each as far from those that it shares bytes with as it is here.

    Args:
        arrays: the first one, which shares bytes with no array before it, lies at the beginning.

    Attributes:
        nbytes: length of all.
    """

    def __init__(self, arrays: Sequence[Array]) -> None:
        self._keep = arrays
        begin = _span(arrays[0])[0]
        joined: list[list[int]] = []
        for first, last in sorted(map(_span, arrays)):
            if joined and first < joined[-1][1]:
                joined[-1][1] = max(joined[-1][1], last)
            else:
                joined.append([first, last])
        self.nbytes = 0
        self._places: list[tuple[int, int, UInt8]] = []  # address, offset, bytes
        for first, last in sorted(joined, key=lambda each: each[0] != begin):
            at = self.nbytes + (first - begin - self.nbytes) % ALIGNMENT
            data = (ctypes.c_uint8 * (last - first)).from_address(first)
            self._places.append((first, at, np.ctypeslib.as_array(data)))
            self.nbytes = at + last - first

    def at(self, array: Array) -> str:
        """Return where an array of them begins, in C++."""
        first = _span(array)[0]
        places = (at + first - a for a, at, data in self._places if a <= first < a + data.size)
        return f"arena.memory + {next(places)}"

    def content(self) -> UInt8:
        """Return all bytes as they are now, zero between the places."""
        content = np.zeros(self.nbytes, np.uint8)
        for _, at, data in self._places:
            content[at : at + data.size] = data
        return content

    def effect(self, function: Callable[[], object], name: str) -> str:
        """Return statements that write what a function writes, whatever there was before.

        Raises:
            WorkflowError: that depends on what there was.
        """
        before = self.content()
        fill = np.random.default_rng(0).integers(0, 256, before.size, np.uint8)
        written, after = np.zeros(before.size, bool), []
        for values in (fill, ~fill):
            self._write(values)
            filled = self.content()
            try:
                function()
                after.append(self.content())
            finally:
                self._write(before)
            written |= after[-1] != filled
        if (after[0] != after[1])[written].any():
            raise WorkflowError(f"{name} depends on memory, which C++ cannot repeat; leave it out")
        lines = []
        (places,) = written.nonzero()
        for run in np.split(places, np.flatnonzero(np.diff(places) != 1) + 1):
            if not run.size:
                break
            said = ", ".join(map(str, after[0][run]))
            lines.append(f"{{ static const uint8_t x[] = {{{said}}}; ")
            lines.append(f"__builtin_memcpy(arena.memory + {run[0]}, x, sizeof x); }}")
        return "\n".join(lines)

    def _write(self, content: UInt8) -> None:
        for _, at, data in self._places:
            data[...] = content[at : at + data.size]


def _span(array: Array) -> tuple[int, int]:
    """Return the addresses of an array's first byte and behind its last one."""
    first = array.__array_interface__["data"][0]
    reach = sum((n - 1) * stride for n, stride in zip(array.shape, array.strides))
    return first, first + reach + array.itemsize
