"""Stops around a network: `observation_stop`, `action_stop`; and `observation_range`, which learns.

deferred: [{observation_range: {file: good.npz}}]        # in a good run
safety: [finite, {observation_stop: {file: good.npz}}]   # in those that follow
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import numpy as np

from unicon_base.arrays import Array, Float32
from unicon_base.errors import WorkflowError
from unicon_base.schema.marks import Matches, Within, positive
from unicon_core.blocks.safety.ranges import RangeStop
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
File = Annotated[str, Matches(r".*\.npz", "a path that ends in .npz")]


class ObservationStop(RangeStop):
    """Stop where a policy gets to see what no good run has shown.

    Before a policy has made one, an observation is all zeros.

    Args:
        observation: of the policy, shape (..., m).
        file: .npz with `lower` and `upper`, shape (m,), as `observation_range` writes it; beside
            the workflow.
        margin: beyond both, as a share of what lies between them.

    Raises:
        WorkflowError: the file does not fit.
    """

    def __init__(
        self,
        observation: Reads,
        *,
        states: States,
        robot: Robot,
        file: File,
        margin: Annotated[float, Within(0.0, MARGIN)] = 0.5,
        relative_to: Path | None = None,
    ) -> None:
        lower, upper = _bounds_of(_path(file, relative_to), observation.shape[-1])
        more = np.maximum(margin * (upper - lower), LEAST)
        bounds = {_label(observation, states): (lower - more, upper + more)}
        super().__init__(states, robot, bounds, "which no good run has shown:")

    def _raise(self) -> None:
        if self.ranges[0].view.any():
            super()._raise()


def action_stop(
    action: Reads,
    *,
    states: States,
    robot: Robot,
    limit: Annotated[float, positive(ACTION)] = 50.0,
) -> RangeStop:
    """Stop where a network's output is NaN or larger than any that moves a robot.

    Args:
        action: of the policy before scale and offset, shape (..., k).
        limit: of each entry.
    """
    return RangeStop(states, robot, {_label(action, states): (-limit, limit)}, "allowed are")


class ObservationRange:
    """Note the lowest and highest value of each entry, and write them when the run ends.

    Args:
        observation: of the policy, shape (..., m).
        file: .npz to write, beside the workflow; one that is there counts too, so that several
            runs add up.
    """

    memory = ("_lower", "_upper")
    pure = False  # it writes a file

    def __init__(self, observation: Reads, *, file: File, relative_to: Path | None = None) -> None:
        path = self._path = _path(file, relative_to)
        size = observation.shape[-1]
        self._seen = observation.reshape(-1, size)
        self._lower, self._upper = (np.full(size, end, np.float32) for end in (np.inf, -np.inf))
        if path.exists():
            self._lower, self._upper = _bounds_of(path, size)

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


def _path(file: str, relative_to: Path | None) -> Path:
    return Path(file) if relative_to is None else relative_to / file


def _bounds_of(path: Path, size: int) -> tuple[Float32, Float32]:
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


def _label(view: Array, states: States) -> str:
    """Return the name of the state that a parameter got, which a workflow may have renamed."""
    start = view.__array_interface__["data"][0]
    return next(n for n in states if states[n].__array_interface__["data"][0] == start)
