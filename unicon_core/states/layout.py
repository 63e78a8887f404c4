"""StateSpec: what one state is. Layout: where each state lies in the one buffer.

Processes and bags compare layouts.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from math import prod
from typing import Annotated, Any

import numpy as np

from unicon_base.errors import StateError
from unicon_base.schema.marks import Made
from unicon_base.schema.read import read_value

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*\Z")
_KINDS = "biuf"  # bool, signed, unsigned, float: what every backend and every language can carry


MAX_ELEMENTS = 1 << 24
"""Elements of one state; more than any sensor's but a camera's, whose pictures are handles."""


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}…"


def check_name(name: str) -> str:
    """Return `name`, or raise StateError where it cannot label a state."""
    if not isinstance(name, str) or not _NAME.match(name):
        raise StateError(
            f"state name {name!r} is not an identifier; use letters, digits and '_', letter first"
        )
    return name


def _shape(value: Any) -> tuple[int, ...]:
    shape = [value] if isinstance(value, int) else value
    if not isinstance(shape, (list, tuple)) or not all(isinstance(n, int) for n in shape):
        raise StateError(f"is {_short(value)}; give a list of whole numbers, such as [3]")
    return tuple(shape)


def _initial(value: Any) -> Any:
    """Return numbers as they are written: `_check_initial` knows the type that they have to fit."""
    return tuple(value) if isinstance(value, list) else value


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

    shape: Annotated[tuple[int, ...], Made(_shape)] = ()
    dtype: str = "float32"
    unit: str = ""
    frame: str = ""
    names: tuple[str, ...] = ()
    description: str = ""
    initial: Annotated[float | tuple[float, ...], Made(_initial)] = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "shape", tuple(map(int, self.shape)))
        object.__setattr__(self, "names", tuple(self.names))
        try:
            dtype = np.dtype(self.dtype)
        except (SyntaxError, TypeError, ValueError) as error:
            raise StateError(
                f"state dtype {self.dtype!r} is not a NumPy type; use float32, int64, bool, …"
            ) from error
        if dtype.kind not in _KINDS:
            raise StateError(
                f"state dtype {self.dtype!r} cannot be shared; use a bool, integer or float type"
            )
        object.__setattr__(self, "dtype", dtype.newbyteorder("=").name)
        if any(n < 1 for n in self.shape):
            raise StateError(f"state shape {self.shape} has an empty axis; every axis needs >= 1")
        if self.size > MAX_ELEMENTS:
            raise StateError(
                f"state shape {_short(self.shape)} has {self.size} elements; at most "
                f"{MAX_ELEMENTS} are held: leave large data outside and refer to them"
            )
        if self.names and (not self.shape or len(self.names) != self.shape[-1]):
            last = self.shape[-1] if self.shape else 1
            raise StateError(f"{len(self.names)} element names for a last axis of {last}")
        if len(set(self.names)) != len(self.names):
            twice = next(name for name in self.names if self.names.count(name) > 1)
            raise StateError(f"element name {twice!r} stands twice; names must be unique")
        if not all(isinstance(name, str) for name in self.names):
            raise StateError(f"element names {_short(list(self.names))} are not all words")
        if isinstance(self.initial, tuple) and len(self.initial) != self.size:
            raise StateError(f"{len(self.initial)} initial values for {self.size} elements")
        for value in self.initial if isinstance(self.initial, tuple) else (self.initial,):
            self._check_initial(value, dtype)

    def _check_initial(self, value: Any, dtype: np.dtype[Any]) -> None:
        """A number that the type holds; NaN says "not yet known" in a float state."""
        fits = isinstance(value, (bool, int, float, np.number, np.bool_))
        if fits and dtype.kind in "iu":
            limits = np.iinfo(dtype)
            fits = limits.min <= value <= limits.max and int(value) == value
        elif fits and dtype.kind == "b":
            fits = value in (0, 1)
        if not fits:
            raise StateError(
                f"initial value {_short(value)} does not fit into {self.dtype}; give one that does"
            )

    @property
    def size(self) -> int:
        """Number of elements for one robot."""
        return prod(self.shape)

    def to_dict(self) -> dict[str, Any]:
        """Return the specification as plain values; `from_dict` reads it back."""
        fields = vars(self).items()
        return {name: list(x) if isinstance(x, tuple) else x for name, x in fields}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> StateSpec:
        """Build a specification from plain values (YAML or JSON).

        Raises:
            StateError: an unknown key, or a value that does not fit.
        """
        found: StateSpec = read_value(cls, values, lambda _, text: StateError(text), "state")
        return found


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
