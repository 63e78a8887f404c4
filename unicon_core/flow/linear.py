"""LinearMap: the tick of a block that copies, and what the compiler reads to fuse neighbours."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from unicon_base.arrays import Array
from unicon_base.errors import StateError


@dataclass(eq=False)
class LinearMap:
    """target = source[…, index] · scale + offset, along the last axis, in the target's type.

    Everything is read before anything is written. A block whose tick it is, or carries one as its
    attribute `linear`, is a copy or a linear index map and nothing else: it is never done.

    Attributes:
        source: view that is read, shape (…, m).
        target: view that is written, shape (…, n).
        index: places in the last axis of the source, integers of shape (n,); None: all, n = m.
        scale: factor, one number or shape (n,); None for none.
        offset: summand in the target's unit, one number or shape (n,); None for none.
        source_name: the source's state, "" where it is none.
        target_name: the target's state, "" where it is none.

    Raises:
        StateError: shapes or an index that do not fit.
    """

    memory = ()

    source: Array
    target: Array
    index: Any = None
    scale: ArrayLike | None = None
    offset: ArrayLike | None = None
    source_name: str = ""
    target_name: str = ""
    _taken: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        label = f"{self.target_name or 'target'} from {self.source_name or 'source'}"
        source, target = self.source, self.target
        shape = source.shape
        if self.index is not None:
            index = np.asarray(self.index)
            last = source.shape[-1] if source.ndim else 0
            if index.ndim != 1 or index.dtype.kind not in "iu":
                raise StateError(f"{label}: the index must be a list of whole numbers")
            wrong = index[(index < 0) | (index >= last)]
            if wrong.size:
                raise StateError(f"{label}: no element {wrong[0]}; there are 0 to {last - 1}")
            shape = (*source.shape[:-1], index.size)
            whole = index.size == last and (index == np.arange(last)).all()
            self.index = None if whole else index.astype(np.intp)
        if shape != target.shape:
            raise StateError(
                f"{label}: shape {shape} into {target.shape}; give an index of as many elements"
            )
        width = target.shape[-1:]
        count = width[0] if width else 1
        dtype = target.dtype if target.dtype.kind == "f" else np.float64
        for name in ("scale", "offset"):
            if getattr(self, name) is not None:
                values = np.ravel(getattr(self, name))
                if values.size not in (1, count):
                    raise StateError(
                        f"{label}: {name} has {values.size} values for {count} elements; give "
                        "one, or one for each"
                    )
                # As wide as the target: broadcasting costs 1.1 µs against 0.2 µs.
                full = np.broadcast_to(values, (count,)).astype(dtype).reshape(width)
                setattr(self, name, full)
        self._taken = np.empty(target.shape, source.dtype)

    @property
    def is_copy(self) -> bool:
        """True where the values arrive as they are, whatever their places."""
        return self.scale is None and self.offset is None

    @property
    def reads(self) -> tuple[str, ...]:
        """The source's state, for the graph check."""
        return (self.source_name,) if self.source_name else ()

    @property
    def writes(self) -> tuple[str, ...]:
        """The target's state, for the graph check."""
        return (self.target_name,) if self.target_name else ()

    def __call__(self) -> None:
        source, target = self.source, self.target
        if self.index is not None:
            # mode "clip" (the index was checked at build) saves NumPy's own buffer, 2x.
            source.take(self.index, -1, self._taken, "clip")
            source = self._taken
        np.copyto(target, source, casting="unsafe")  # NumPy sees an overlap and minds it
        if self.scale is not None:
            np.multiply(target, self.scale, out=target, casting="unsafe")
        if self.offset is not None:
            np.add(target, self.offset, out=target, casting="unsafe")
