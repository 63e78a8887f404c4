"""Series: states of a record as those of a program, tick by tick; for platform and block."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import StateError, UniconError
from unicon_core.runtime.phases import Phase
from unicon_core.states import States
from unicon_core.states.standard import JOINT_STATES
from unicon_ros.recording import Record, open_record
from unicon_ros.replay.alignment import elements, refuse_other_batch

MOVING = (Phase.RUN.value, Phase.SOFT.value)
"""Phases of a run in which its flow ticks."""


def opened(bag: str, relative_to: Path | None) -> Record:
    """Open a record that a workflow names: beside its file, or from the working folder.

    Raises:
        UniconError: it cannot be read.
    """
    beside = None if relative_to is None else relative_to / bag
    if beside is not None and os.path.exists(beside):
        return open_record(beside)
    return open_record(os.path.expanduser(bag))  # which leaves a user alone who is not known


class Series:
    """What is put into a program's states in its ticks.

    Where the record ticked at another rate, a tick gets the newest values that had come by then.

    Args:
        record: the record; ticks of its flow, or all where it has none.
        names: states that are wanted; those that it does not have are left out.
        moment: of its ticks.
        states: of the program, elements aligned by name.
        period: of the program's ticks in [s]; None for the record's own ticks, one by one.
        start: how much of the record is left out at its beginning, in [s].

    Attributes:
        names: states that are there.
        rows: row of the record for each tick, shape (ticks,).

    Raises:
        StateError: it is empty, or lacks joints of the robot.
    """

    def __init__(
        self,
        record: Record,
        names: Sequence[str],
        moment: str,
        states: States,
        period: float | None,
        start: float = 0.0,
    ) -> None:
        self.record = record
        self.rows = _rows(record, period, start)
        found: dict[str, tuple[NDArray[np.generic], NDArray[np.generic]]] = {}
        for name in names:
            if name not in record.kept[moment] or name not in states:
                continue
            values = _aligned(record, name, moment, states)
            if values is not None:
                found[name] = states[name], values[self.rows]
        self._pairs = tuple(found.values())
        self._values = {name: values for name, (_, values) in found.items()}
        self.names = tuple(found)

    def __len__(self) -> int:
        return len(self.rows)

    def values(self, name: str) -> NDArray[np.generic]:
        """Return a state in every tick of the program, shape (ticks, …)."""
        return self._values[name]

    def put(self, tick: int) -> None:
        """Put the states of a tick into the program's."""
        for view, values in self._pairs:
            view[...] = values[tick]


def _rows(record: Record, period: float | None, start: float) -> NDArray[np.intp]:
    ended = np.flatnonzero(record.ended)
    rows = np.array([i for i in ended if record.phases[i] in MOVING], np.intp)
    rows = rows if len(rows) else ended
    if not len(rows):
        raise StateError("the record holds no tick that ended: nothing can be replayed")
    own = record.period
    # Clocks may be set back.
    times = np.maximum.accumulate(record.stamps[rows] - record.stamps[rows[0]]) * 1e-9
    same = period is None or abs(period - own) <= 1e-6 * own
    if not same:
        assert period is not None
        grid = np.arange(int(float(times[-1]) / period + 1e-6) + 1) * period
        rows = rows[np.searchsorted(times, grid + 1e-9, side="right") - 1]
    skipped = start / (own if same or period is None else period)
    if not 0.0 <= skipped < len(rows) - 0.5:
        raise UniconError(
            f"start is {start:g} s, and the record is {float(times[-1]):.3g} s long; give less, "
            "from 0 on"
        )
    return rows[round(skipped) :]


def _aligned(record: Record, name: str, moment: str, states: States) -> NDArray[np.generic] | None:
    """Return a state of the record with the program's elements, None where they do not fit."""
    theirs, ours = record.layout.specs[name], states.spec(name)
    values: NDArray[np.generic] = record.states(name, moment)
    refuse_other_batch(record, states)
    if theirs.names != ours.names:
        lacking = [each for each in ours.names if each not in theirs.names]
        if lacking and name in JOINT_STATES:
            raise StateError(
                f"the record is of robot {record.facts.get('robot', '?')} and has no joint "
                f"{lacking[0]!r} ({name}); its joints: {', '.join(theirs.names)}"
            )
        if lacking or not ours.names:
            return None
        order = elements(theirs.names, ours.names)
        values = values if order is None else values[..., order]
    same = values.shape[1:] == states[name].shape and values.dtype == states[name].dtype
    return values if same else None
