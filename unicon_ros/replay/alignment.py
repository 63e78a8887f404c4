"""Alignment: elements of a record's states by name with those of a program; for replays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import StateError
from unicon_core.states import States
from unicon_ros.recording import Record


def refuse_other_batch(record: Record, states: States) -> None:
    """Refuse a record of another number of robots than a program's.

    Raises:
        StateError: it is.
    """
    if record.layout.num_robots != states.num_robots:
        raise StateError(
            f"the record is of {record.layout.num_robots or 1} robots and the workflow of "
            f"{states.num_robots or 1}; give the workflow the same num_robots"
        )


def elements(theirs: Sequence[str], ours: Sequence[str]) -> NDArray[np.intp] | None:
    """Return which element of the record is each of ours, shape (n,); None where all are alike.

    Args:
        theirs: names of the record's elements, ours among them.
        ours: names of the program's.
    """
    if tuple(theirs) == tuple(ours):
        return None
    places = {name: i for i, name in enumerate(theirs)}
    return np.array([places[name] for name in ours], np.intp)
