"""Blocks `copy` and `linear_map`: one state from another; the compiler fuses adjacent ones.

What they do is all in their attributes, so that a compiler can read it: `target[..., :]` becomes
`source[..., index] · scale + offset`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import StateError, alternatives
from unicon_core.states import States

__all__ = ["LinearMap", "copy", "linear_map"]


def copy(
    *,
    states: States,
    source: str,
    target: str,
    index: Sequence[int | str] | None = None,
) -> LinearMap:
    """Copy a state, or some of its elements, into another state.

    Args:
        source: label of the state that is read, shape (..., m).
        target: label of the state that is written, shape (..., k).
        index: k elements of the source's last axis, by number or by element name; None for all.

    Raises:
        StateError: no such state or element, or the sizes differ.
    """
    return LinearMap(states, source, target, index, None, None)


def linear_map(
    *,
    states: States,
    source: str,
    target: str,
    index: Sequence[int | str] | None = None,
    scale: float | Sequence[float] = 1.0,
    offset: float | Sequence[float] = 0.0,
) -> LinearMap:
    """Write `source[..., index] · scale + offset` into another state.

    Args:
        source: label of the state that is read, shape (..., m).
        target: label of the state that is written, shape (..., k).
        index: k elements of the source's last axis, by number or by element name; None for all.
        scale: one factor, or one for each of the k elements.
        offset: one summand, or one for each of the k elements, in the target's unit.

    Raises:
        StateError: no such state or element, or the sizes differ.
    """
    return LinearMap(states, source, target, index, scale, offset)


class LinearMap:
    """The tick of `copy` and `linear_map`.

    Attributes:
        source, target: views of the states.
        source_label, target_label: their names.
        index: elements of the source's last axis, intp, shape (k,).
        scale, offset: float32, shape (k,), or None for a plain copy.
        reads, writes: the labels, for the graph check.
    """

    def __init__(
        self,
        states: States,
        source: str,
        target: str,
        index: Sequence[int | str] | None,
        scale: float | Sequence[float] | None,
        offset: float | Sequence[float] | None,
    ) -> None:
        self.source_label, self.target_label = source, target
        self.reads, self.writes = (source,), (target,)
        # A scalar state is one element: a last axis for it makes all states alike.
        scalar_in, scalar_out = not states.spec(source).shape, not states.spec(target).shape
        view = states[source][..., None] if scalar_in else states[source]
        self.source: NDArray[Any] = view.view()
        self.source.flags.writeable = False
        self.target: NDArray[Any] = states[target][..., None] if scalar_out else states[target]
        size = self.source.shape[-1]
        names = states.spec(source).names
        self.index = (
            np.arange(size, dtype=np.intp)
            if index is None
            else np.array([_element(e, names, size, source) for e in index], dtype=np.intp)
        )
        wanted = (*self.source.shape[:-1], len(self.index))
        if self.target.shape != wanted:
            raise StateError(
                f"{len(self.index)} elements of {source!r} (shape {wanted}) do not fit into "
                f"{target!r} of shape {self.target.shape}; give an index of as many elements"
            )
        self.scale = None if scale is None else self._vector(scale, "scale")
        self.offset = None if offset is None else self._vector(offset, "offset")
        self._whole = index is None and self.source.dtype == self.target.dtype
        self._scratch = np.zeros(wanted, self.source.dtype)

    def _vector(self, values: float | Sequence[float], what: str) -> NDArray[np.float32]:
        vector = np.asarray(values, np.float32)
        if vector.shape not in ((), (1,), (len(self.index),)):
            raise StateError(
                f"{what} has {vector.size} values for {len(self.index)} elements of "
                f"{self.target_label!r}; give one, or one for each"
            )
        filled = np.empty(len(self.index), np.float32)
        filled[:] = vector
        return filled

    def __call__(self) -> None:
        if self._whole:
            self.target[...] = self.source
        else:
            # mode="clip" (the index was checked at build) saves NumPy's own buffer.
            np.take(self.source, self.index, axis=-1, out=self._scratch, mode="clip")
            self.target[...] = self._scratch
        if self.scale is not None:
            np.multiply(self.target, self.scale, out=self.target, casting="unsafe")
        if self.offset is not None:
            np.add(self.target, self.offset, out=self.target, casting="unsafe")


def _element(element: int | str, names: tuple[str, ...], size: int, label: str) -> int:
    if isinstance(element, str):
        if element not in names:
            raise StateError(
                f"state {label!r} has no element {element!r}; {alternatives(element, names)}"
            )
        return names.index(element)
    if not 0 <= element < size:
        raise StateError(f"state {label!r} has no element {element}; there are 0 to {size - 1}")
    return int(element)
