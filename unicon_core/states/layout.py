"""Layout: where each state stands in the one buffer; a value that processes and bags compare."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from math import prod
from typing import Any

import numpy as np

from unicon_base.errors import StateError
from unicon_core.states.spec import StateSpec, check_name

ALIGNMENT = 64
"""Alignment of the buffer and of each dtype's section, in bytes: one cache line."""


MAX_BYTES = 1 << 30
"""Length of the buffer: room for a large batch, and no mistyped shape takes the machine down."""


@dataclass(frozen=True)
class Slot:
    """Place of one state: byte `offset`, full `shape` with the batch axis, dtype name."""

    offset: int
    shape: tuple[int, ...]
    dtype: str

    @property
    def nbytes(self) -> int:
        """Length in bytes."""
        return prod(self.shape) * np.dtype(self.dtype).itemsize


@dataclass(frozen=True)
class Layout:
    """All states of a workflow, in declaration order, grouped by dtype without gaps inside a group.

    States of one dtype stand back to back, so that a gather over all float32 states is one
    `np.take` and adjacent copies melt into one (a cache line per state would cost both).

    Attributes:
        specs: name to specification, in declaration order.
        num_robots: leading batch dimension, or None for none.
    """

    specs: Mapping[str, StateSpec]
    num_robots: int | None = None

    def __post_init__(self) -> None:
        for name in self.specs:
            check_name(name)
        object.__setattr__(self, "specs", dict(self.specs))
        if self.num_robots is not None and self.num_robots < 1:
            raise StateError(
                f"num_robots is {self.num_robots}; give a number >= 1, or leave it out"
            )

        if self.nbytes > MAX_BYTES:
            raise StateError(
                f"the states take {self.nbytes >> 20} MiB; at most {MAX_BYTES >> 20} are held: "
                "make shapes or num_robots smaller"
            )

    @cached_property
    def slots(self) -> dict[str, Slot]:
        """Name to place, in declaration order."""
        return self._placed[0]

    @cached_property
    def sections(self) -> dict[str, tuple[int, int]]:
        """Dtype name to (byte offset, number of elements) of its section."""
        return self._placed[1]

    @cached_property
    def nbytes(self) -> int:
        """Length of the buffer in bytes, a multiple of 64."""
        return self._placed[2]

    @cached_property
    def _placed(self) -> tuple[dict[str, Slot], dict[str, tuple[int, int]], int]:
        batch = () if self.num_robots is None else (self.num_robots,)
        dtypes = dict.fromkeys(["float32", *(spec.dtype for spec in self.specs.values())])
        places: dict[str, Slot] = {}
        sections: dict[str, tuple[int, int]] = {}
        offset = 0
        for dtype in dtypes:
            start, itemsize = offset, np.dtype(dtype).itemsize
            for name, spec in self.specs.items():
                if spec.dtype == dtype:
                    places[name] = Slot(offset, batch + spec.shape, dtype)
                    offset += places[name].nbytes
            sections[dtype] = (start, (offset - start) // itemsize)
            offset = -(-offset // ALIGNMENT) * ALIGNMENT
        return {name: places[name] for name in self.specs}, sections, max(offset, ALIGNMENT)

    def elements(self, name: str) -> list[str]:
        """Return the elements of a state in C order, `joint_pos.FL_hip_joint` or `contact.0`.

        Raises:
            KeyError: no such state.
        """
        names = self.specs[name].names
        axes: list[Sequence[object]] = [range(length) for length in self.slots[name].shape]
        if names:
            axes[-1] = names
        return [".".join([name, *map(str, place)]) for place in product(*axes)]

    @cached_property
    def hash(self) -> str:
        """SHA-256 over the canonical JSON: equal in two processes exactly when the bytes fit."""
        return hashlib.sha256(self.to_json().encode()).hexdigest()

    def __hash__(self) -> int:
        return int(self.hash[:15], 16)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Layout) and self.to_json() == other.to_json()

    def to_json(self) -> str:
        """Return the layout as canonical JSON; `from_json` reads it back."""
        states = [{"name": name, **spec.to_dict()} for name, spec in self.specs.items()]
        value = {"num_robots": self.num_robots, "states": states}
        return json.dumps(value, separators=(",", ":"), sort_keys=True)

    @classmethod
    def from_json(cls, text: str) -> Layout:
        """Read a layout back from `to_json`.

        Raises:
            StateError: the text is not a layout.
        """
        try:
            value: dict[str, Any] = json.loads(text)
            specs = {entry.pop("name"): StateSpec.from_dict(entry) for entry in value["states"]}
            num_robots = value["num_robots"]
            if num_robots is not None and type(num_robots) is not int:
                raise StateError(f"num_robots is {num_robots!r}; give a whole number or null")
            return cls(specs, num_robots)
        except (KeyError, TypeError, ValueError) as error:
            raise StateError(
                f"not a state layout: {error}; write it with Layout.to_json"
            ) from error
