"""LinearMap: what a copying block says about itself, for the compiler that fuses neighbours."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import StateError

__all__ = ["LinearMap", "linear_of"]

Array = NDArray[Any]


@dataclass(frozen=True, eq=False)
class LinearMap:
    """target = source[…, index] · scale + offset, along the last axis, in the target's type.

    Everything is read before anything is written. A block whose callable carries one as its
    attribute `linear` is a copy or a linear index map and nothing else: it is never done.

    Attributes:
        source: view that is read, shape (…, m).
        target: view that is written, shape (…, n).
        index: places in the last axis of the source, integers of shape (n,); None: all, n = m.
        scale: factor, one number or shape (n,), in the target's type; None for none.
        offset: summand in the target's unit, one number or shape (n,); None for none.
        source_name: the source's state, for messages.
        target_name: the target's state, for messages.

    Raises:
        StateError: shapes, types or an index that do not fit.
    """

    source: Array
    target: Array
    index: Array | None = None
    scale: Array | float | None = None
    offset: Array | float | None = None
    source_name: str = "source"
    target_name: str = "target"

    def __post_init__(self) -> None:
        label = f"{self.target_name} from {self.source_name}"
        source, target = self.source, self.target
        if source.dtype != target.dtype:
            raise StateError(
                f"{label}: {source.dtype} into {target.dtype}; give both states one dtype"
            )
        linear = self.scale is not None or self.offset is not None
        if linear and target.dtype.kind != "f":
            raise StateError(f"{label}: scale and offset need a float state, not {target.dtype}")
        if self.index is not None:
            index = np.asarray(self.index)
            last = source.shape[-1] if source.ndim else 0
            if index.ndim != 1 or index.dtype.kind not in "iu":
                raise StateError(f"{label}: the index must be a list of whole numbers")
            if index.size and not (index.min() >= 0 and index.max() < last):
                wrong = index[(index < 0) | (index >= last)][0]
                raise StateError(f"{label}: index {wrong} outside a last axis of {last}")
            whole = index.size == last and (index == np.arange(last)).all()
            object.__setattr__(self, "index", None if whole else index.astype(np.intp))
        shape = source.shape if self.index is None else (*source.shape[:-1], self.index.size)
        if shape != target.shape:
            raise StateError(f"{label}: shape {shape} into {target.shape}; both must be the same")
        for name in ("scale", "offset"):
            value = getattr(self, name)
            if value is None:
                continue
            value = np.asarray(value, dtype=target.dtype)
            if value.ndim > 1 or (value.ndim == 1 and value.shape != target.shape[-1:]):
                raise StateError(
                    f"{label}: {name} of shape {value.shape} for a last axis of "
                    f"{target.shape[-1] if target.ndim else 1}; give one number or one for each"
                )
            object.__setattr__(self, name, value)

    @property
    def is_copy(self) -> bool:
        """True where the values arrive as they are, whatever their places."""
        return self.scale is None and self.offset is None

    def operation(self) -> Callable[[], None]:
        """Return the function that does it; nothing is allocated in a call."""
        source, target, index = self.source, self.target, self.index
        scale: Any = self.scale
        offset: Any = self.offset
        copyto, multiply, add = np.copyto, np.multiply, np.add
        if index is None and self.is_copy:
            return lambda: copyto(target, source)  # NumPy sees an overlap and minds it
        overlap = np.may_share_memory(source, target)
        result = np.empty_like(target) if overlap or not target.flags.c_contiguous else target

        def run() -> None:
            if index is not None:
                # mode 'clip' writes straight into the result; 'raise' goes through a buffer, 2x
                source.take(index, -1, result, "clip")
                if scale is not None:
                    multiply(result, scale, result)
                if offset is not None:
                    add(result, offset, result)
            elif scale is None:
                add(source, offset, result)
            else:
                multiply(source, scale, result)
                if offset is not None:
                    add(result, offset, result)
            if result is not target:
                copyto(target, result)

        return run


def linear_of(candidate: object) -> LinearMap | None:
    """Return what a callable says about itself: its attribute `linear`, or the same by its parts.

    The parts are `source`, `target`, `index`, `scale` and `offset`, and `source_label` and
    `target_label` where it has them. What is no linear map in one dtype gives None.
    """
    linear = getattr(candidate, "linear", None)
    if linear is not None or isinstance(candidate, type):
        return linear if isinstance(linear, LinearMap) else None
    parts = [getattr(candidate, name, None) for name in ("source", "target", "index")]
    if not (isinstance(parts[0], np.ndarray) and isinstance(parts[1], np.ndarray)):
        return None
    if not (hasattr(candidate, "scale") and hasattr(candidate, "offset")):
        return None
    labels = [getattr(candidate, name, "") for name in ("source_label", "target_label")]
    try:
        return LinearMap(parts[0], parts[1], parts[2], candidate.scale, candidate.offset, *labels)
    except StateError:
        return None
