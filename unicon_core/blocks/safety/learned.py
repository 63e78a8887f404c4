"""Stops around a network: `observation_stop`, `action_stop`; and `observation_range`, which learns.

deferred: [{observation_range: {file: good.npz}}]        # in a good run
safety: [finite, {observation_stop: {file: good.npz}}]   # in those that follow
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.blocks.safety.ranges import RangeStop
from unicon_core.bounds import within
from unicon_core.errors import WorkflowError
from unicon_core.flow.block import Reads
from unicon_core.robots import Robot
from unicon_core.states import States

MARGIN = 10.0
"""Largest margin: beyond ten times of what was seen nothing is unusual."""
ACTION = 1000.0
"""Largest limit of an action: published policies give up to some 10."""
LEAST = 1e-3
"""What an entry that never changed may change by."""
LARGEST_FILE = 16 * 2**20
"""In bytes, of a file of bounds."""


def observation_stop(
    observation: Reads,
    *,
    states: States,
    robot: Robot,
    file: str,
    margin: float = 0.5,
    relative_to: Path | None = None,
) -> ObservationStop:
    """Stop where a policy gets to see what no good run has shown.

    Args:
        observation: of the policy, shape (..., m).
        file: .npz with `lower` and `upper`, shape (m,), as `observation_range` writes it; beside
            the workflow.
        margin: beyond both, as a share of what lies between them.

    Raises:
        WorkflowError: an option is not plausible, or the file does not fit.
    """
    margin = within(margin, "margin", "", MARGIN, above=False, what="observation_stop")
    lower, upper = _bounds_of(_path(file, relative_to), observation.shape[-1])
    more = np.maximum(margin * (upper - lower), LEAST)
    bounds = {_label(observation, states): (lower - more, upper + more)}
    return ObservationStop(states, robot, bounds, "which no good run has shown:")


class ObservationStop(RangeStop):
    """The tick of `observation_stop`; before a policy has made one, an observation is all zeros."""

    def _raise(self) -> None:
        if self.ranges[0].view.any():
            super()._raise()


def action_stop(action: Reads, *, states: States, robot: Robot, limit: float = 50.0) -> RangeStop:
    """Stop where a network's output is NaN or larger than any that moves a robot.

    Args:
        action: of the policy before scale and offset, shape (..., k).
        limit: of each entry.
    """
    limit = within(limit, "limit", "", ACTION, what="action_stop")
    return RangeStop(states, robot, {_label(action, states): (-limit, limit)}, "allowed are")


def observation_range(
    observation: Reads, *, file: str, relative_to: Path | None = None
) -> ObservationRange:
    """Note the lowest and highest value of each entry, and write them when the run ends.

    Args:
        observation: of the policy, shape (..., m).
        file: .npz to write, beside the workflow; one that is there counts too, so that several
            runs add up.
    """
    path = _path(file, relative_to)
    size = observation.shape[-1]
    known = _bounds_of(path, size) if path.exists() else None
    return ObservationRange(observation, path, known)


class ObservationRange:
    """The tick of `observation_range`."""

    memory = ("_lower", "_upper")

    def __init__(
        self,
        observation: NDArray[np.float32],
        path: Path,
        known: tuple[NDArray[np.float32], NDArray[np.float32]] | None,
    ) -> None:
        self._seen, self._path = observation.reshape(-1, observation.shape[-1]), path
        size = self._seen.shape[-1]
        self._lower, self._upper = known or (
            np.full(size, np.inf, np.float32),
            np.full(size, -np.inf, np.float32),
        )

    def __call__(self) -> None:
        for row in self._seen:
            if not row.any():  # no policy has made it yet
                continue
            np.fmin(self._lower, row, out=self._lower)
            np.fmax(self._upper, row, out=self._upper)

    def close(self) -> None:
        """Write what was seen, all of it or nothing."""
        if not np.isfinite(self._lower).all():
            return  # no tick
        part = self._path.with_name(f".{self._path.name}.{os.getpid()}")
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with part.open("wb") as stream:
            np.savez(stream, lower=self._lower, upper=self._upper)
        part.replace(self._path)


observation_range.pure = False  # type: ignore[attr-defined]  # it writes a file


def _path(file: str, relative_to: Path | None) -> Path:
    path = Path(file)
    if path.suffix != ".npz":
        raise WorkflowError(f"file is {file!r}; give a path that ends in .npz")
    return path if relative_to is None else relative_to / path


def _bounds_of(path: Path, size: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return `lower` and `upper` of a file, shape (m,)."""
    remedy = "write it with observation_range in a good run"
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise ValueError("it is too large")
        with np.load(path, allow_pickle=False) as values:
            if sum(entry.file_size for entry in values.zip.infolist()) > LARGEST_FILE:
                raise ValueError("it is too large")
            lower, upper = (np.asarray(values[key], np.float32) for key in ("lower", "upper"))
    except Exception as error:  # what np.load raises of garbage is of many kinds
        said = "no such file" if isinstance(error, FileNotFoundError) else str(error)
        raise WorkflowError(f"file {path}: {said}; {remedy}") from error
    if lower.shape != (size,) or upper.shape != (size,):
        raise WorkflowError(
            f"file {path}: it has bounds for {lower.size} values and the observation has {size}; "
            f"{remedy}"
        )
    if not (np.isfinite(lower).all() and np.isfinite(upper).all() and (lower <= upper).all()):
        raise WorkflowError(f"file {path}: its bounds are not finite and in order; {remedy}")
    return lower, upper


def _label(view: NDArray[Any], states: States) -> str:
    """Return the name of the state that a parameter got, which a workflow may have renamed."""
    start = view.__array_interface__["data"][0]
    return next(n for n in states if states[n].__array_interface__["data"][0] == start)
