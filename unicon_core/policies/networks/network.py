"""What a policy asks of the network behind it: named tensors, bound to arrays, for all runtimes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol, TypeAlias, runtime_checkable

from unicon_base.arrays import Array


@dataclass(frozen=True)
class Tensor:
    """An input or output: `shape` has an int for a fixed axis and a name (or "") for a free one."""

    name: str
    dtype: str
    shape: tuple[int | str, ...]

    @property
    def free_batch(self) -> bool:
        """Whether the first axis takes any length."""
        return bool(self.shape) and not isinstance(self.shape[0], int)

    @property
    def width(self) -> int | str:
        """The last axis; 1 of a scalar."""
        return self.shape[-1] if self.shape else 1

    def takes(self, size: int) -> bool:
        """Whether the last axis has this length, or is free."""
        return not isinstance(self.width, int) or self.width == size

    def __str__(self) -> str:
        axes = " × ".join(str(axis) or "?" for axis in self.shape)
        return f"{self.name} ({axes or 'scalar'}, {self.dtype})"


Arrays: TypeAlias = Mapping[str, Array]
"""Tensors' names to what they are bound to."""


class Network(Protocol):
    """A network that can be bound to arrays."""

    inputs: tuple[Tensor, ...]
    outputs: tuple[Tensor, ...]

    def bind(self, inputs: Arrays, outputs: Arrays) -> Callable[[], None]:
        """Return a function that reads `inputs` and writes `outputs`, which stay where they are.

        Where the network remembers inside itself, the function is `Remembering`.
        """
        ...


@runtime_checkable
class Remembering(Protocol):
    """A bound network with a memory of its own: a call begins with what was kept last."""

    def __call__(self) -> None:
        """Run the network; what it remembers of this is lost unless it is kept."""
        ...

    def commit(self) -> None:
        """Keep what the last call left."""
        ...

    def reset(self) -> None:
        """Keep what the network was loaded with."""
        ...
