"""Columns: the states of a record as the states of a program, aligned by name; for replays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import StateError
from unicon_core.states import States, StateSpec
from unicon_ros.recording import Record
from unicon_ros.replay.alignment import elements, refuse_other_batch


class Columns:
    """What a record has of a program's states, elements in the program's order.

    Args:
        record: the record.
        states: of the program.

    Attributes:
        names: states that both have with the same elements.
        lacking: what is of one side alone, or of other sizes, one line each.

    Raises:
        StateError: the record is of a robot with other joints, or of another number of robots.
    """

    def __init__(self, record: Record, states: States) -> None:
        self._record, self._states = record, states
        refuse_other_batch(record, states)
        self._index: dict[str, NDArray[np.intp] | None] = {}
        self.lacking: list[str] = []
        theirs, ours = record.layout.specs, states.layout.specs
        _refuse_other_robot(record, theirs, ours)
        for name, spec in ours.items():
            if name not in theirs:
                self.lacking.append(f"state {name!r} is not in the record")
            elif (theirs[name].shape, theirs[name].dtype) != (spec.shape, spec.dtype):
                self.lacking.append(
                    f"state {name!r} is {theirs[name].dtype} of shape {theirs[name].shape} in the "
                    f"record and {spec.dtype} of shape {spec.shape} here: it is not compared"
                )
            elif sorted(theirs[name].names) != sorted(spec.names):
                self.lacking.append(f"state {name!r} has other elements in the record")
            else:
                self._index[name] = elements(theirs[name].names, spec.names)
        self.lacking += [f"state {n!r} of the record is not here" for n in theirs if n not in ours]
        self.names = tuple(self._index)
        self._turned = [name for name, index in self._index.items() if index is not None]
        self._partly = len(record.kept["received"]) < len(record.layout.slots)
        self._kept: dict[tuple[str, str], NDArray[Any]] = {}

    def column(self, name: str, moment: str) -> NDArray[Any]:
        """Return a state of `names` in every tick, shape (ticks, …)."""
        key = (name, moment)
        if key not in self._kept:
            values, index = self._record.states(name, moment), self._index[name]
            self._kept[key] = values if index is None else np.ascontiguousarray(values[..., index])
        return self._kept[key]

    def kept(self, moment: str, names: Sequence[str]) -> list[str]:
        """Return those of some states that the record has at a moment."""
        return [name for name in names if name in self._record.kept[moment]]

    def begin(self, row: int) -> None:
        """Put states into the program as they were received in a tick."""
        if row and self._partly:  # what did not come from outside is what the tick before left
            self._record.feed("sent", row - 1, self._states)
            self._align("sent", row - 1)
        self._record.feed("received", row, self._states)
        self._align("received", row)

    def _align(self, moment: str, row: int) -> None:
        for name in self._turned:
            if name in self._record.kept[moment]:
                self._states[name][...] = self.column(name, moment)[row]


def _refuse_other_robot(
    record: Record, theirs: Mapping[str, StateSpec], ours: Mapping[str, StateSpec]
) -> None:
    joints = [set(specs["joint_pos"].names) for specs in (theirs, ours) if "joint_pos" in specs]
    if len(joints) == 2 and joints[0] != joints[1]:
        odd = sorted(joints[0] ^ joints[1])
        raise StateError(
            f"the record is of robot {record.facts.get('robot', '?')} with {len(joints[0])} joints "
            f"and the workflow's has {len(joints[1])}; joint {odd[0]!r} is of one alone: give a "
            "workflow for the recorded robot"
        )
