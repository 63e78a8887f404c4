"""LinearMap: what a copying block says about itself, for the compiler that fuses neighbours."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import StateError

__all__ = ["LinearMap"]

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
            object.__setattr__(self, "index", index.astype(np.intp))
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

    def operation(self) -> Callable[[], object]:
        """Return the function that does it: nothing is allocated in a call, except by overlap."""
        source, target, index = self.source, self.target, self.index
        scale: Any = self.scale
        offset: Any = self.offset
        if index is None and self.is_copy:
            return lambda: np.copyto(target, source)
        if np.may_share_memory(source, target):
            own, outer = LinearMap(source.copy(), target, index, scale, offset), source
            inner = own.operation()

            def through_scratch() -> None:
                np.copyto(own.source, outer)
                inner()

            return through_scratch
        steps: list[Callable[[], object]] = []
        if index is None:
            if scale is not None:
                steps.append(lambda: np.multiply(source, scale, target))
            else:
                return lambda: np.add(source, offset, target)
        elif target.flags.c_contiguous:
            # mode 'clip' writes straight into the target; 'raise' goes through a buffer, 2x
            steps.append(lambda: source.take(index, -1, target, "clip"))
            if scale is not None:
                steps.append(lambda: np.multiply(target, scale, target))
        else:
            scratch = np.empty(target.shape, target.dtype)
            whole = LinearMap(source, scratch, index, scale, offset).operation()
            steps += [whole, lambda: np.copyto(target, scratch)]
            offset = None
        if offset is not None:
            steps.append(lambda: np.add(target, offset, target))
        if len(steps) == 1:
            return steps[0]

        def run() -> None:
            for step in steps:
                step()

        return run
