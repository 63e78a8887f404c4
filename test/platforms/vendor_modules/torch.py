"""Stand-in for PyTorch: what the adapters need of its tensors, over NumPy.

https://docs.pytorch.org/docs/2.7/tensors.html, /generated/torch.from_numpy.html
"""

from __future__ import annotations

from typing import Any

import numpy as np
from vendor_world import Refused, exact


class Tensor:
    """A tensor on the CPU."""

    def __init__(self, array: np.ndarray[Any, Any]) -> None:
        self._array = array

    @property
    def shape(self) -> tuple[int, ...]:
        return self._array.shape

    def to(self, device: str, /) -> Tensor:
        exact(device, str, "device")
        if device != "cpu":
            raise Refused(f"no device {device}")
        return self

    def cpu(self) -> Tensor:
        return self

    def numpy(self) -> np.ndarray[Any, Any]:
        return self._array


def from_numpy(ndarray: np.ndarray[Any, Any], /) -> Tensor:
    """Return a tensor that shares the array's memory."""
    exact(ndarray, np.ndarray, "ndarray")
    return Tensor(ndarray)
