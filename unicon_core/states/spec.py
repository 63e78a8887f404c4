"""StateSpec: what one state is, for whoever declares or checks one."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np

from unicon_core.errors import StateError

__all__ = ["StateSpec", "check_name"]

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*\Z")
_KINDS = "biuf"  # bool, signed, unsigned, float: what every backend and every language can carry


def check_name(name: str) -> str:
    """Return `name`, or raise StateError where it cannot label a state."""
    if not isinstance(name, str) or not _NAME.match(name):
        raise StateError(
            f"state name {name!r} is not an identifier; use letters, digits and '_', letter first"
        )
    return name


@dataclass(frozen=True)
class StateSpec:
    """Shape, type and meaning of one state.

    Attributes:
        shape: shape for one robot, without the batch dimension; `()` is a scalar.
        dtype: NumPy type name, little endian where it matters; float32 unless told.
        unit: unit of every element in the field's notation (`rad`, `m/s`), empty if none.
        frame: frame of reference (`base`, `world`), empty if none.
        names: element names along the last axis (joint names), or empty.
        description: one line for tables.
        initial: value at start and after `States.reset`, one number or one for each element.
    """

    shape: tuple[int, ...] = ()
    dtype: str = "float32"
    unit: str = ""
    frame: str = ""
    names: tuple[str, ...] = ()
    description: str = ""
    initial: float | tuple[float, ...] = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "shape", tuple(int(n) for n in self.shape))
        object.__setattr__(self, "names", tuple(self.names))
        try:
            dtype = np.dtype(self.dtype)
        except TypeError as error:
            raise StateError(
                f"state dtype {self.dtype!r} is no NumPy type; use float32, int64, bool, …"
            ) from error
        if dtype.kind not in _KINDS:
            raise StateError(
                f"state dtype {self.dtype!r} cannot be shared; use a bool, integer or float type"
            )
        object.__setattr__(self, "dtype", dtype.newbyteorder("=").name)
        if any(n < 1 for n in self.shape):
            raise StateError(f"state shape {self.shape} has an empty axis; every axis needs >= 1")
        if self.names and (not self.shape or len(self.names) != self.shape[-1]):
            last = self.shape[-1] if self.shape else 1
            raise StateError(f"{len(self.names)} element names for a last axis of {last}")
        if len(set(self.names)) != len(self.names):
            twice = next(name for name in self.names if self.names.count(name) > 1)
            raise StateError(f"element name {twice!r} stands twice; names must be unique")
        if isinstance(self.initial, tuple) and len(self.initial) != self.size:
            raise StateError(f"{len(self.initial)} initial values for {self.size} elements")

    @property
    def size(self) -> int:
        """Number of elements for one robot."""
        return prod(self.shape)

    def to_dict(self) -> dict[str, Any]:
        """Return the specification as plain values; `from_dict` reads it back."""
        return {
            "shape": list(self.shape),
            "dtype": self.dtype,
            "unit": self.unit,
            "frame": self.frame,
            "names": list(self.names),
            "description": self.description,
            "initial": list(self.initial) if isinstance(self.initial, tuple) else self.initial,
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> StateSpec:
        """Build a specification from plain values (YAML or JSON).

        Raises:
            StateError: an unknown key, or a value that does not fit.
        """
        unknown = set(values) - set(cls.__dataclass_fields__)
        if unknown:
            raise StateError(
                f"unknown key {sorted(unknown)[0]!r} in a state specification; "
                f"known: {', '.join(cls.__dataclass_fields__)}"
            )
        fields = dict(values)
        shape = fields.get("shape", ())
        shape = [shape] if isinstance(shape, int) else shape
        if not isinstance(shape, (list, tuple)) or not all(isinstance(n, int) for n in shape):
            raise StateError(f"state shape is {shape!r}; give a list of whole numbers, such as [3]")
        fields["shape"] = tuple(shape)
        if "names" in fields:
            fields["names"] = tuple(fields["names"])
        if isinstance(fields.get("initial"), list):
            fields["initial"] = tuple(fields["initial"])
        return cls(**fields)
