"""Kept states: those of every tick of a rollout, as a file that `unicon analyze` reads."""

from __future__ import annotations

import io
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from unicon_core.errors import UniconError
from unicon_core.page import write_file
from unicon_core.runtime.rollouts import Rollout
from unicon_core.states import States
from unicon_core.workflow import Program


def columns_of(states: States, names: Iterable[str]) -> dict[str, slice]:
    """Return where states lie in `Rollout.states`: name to columns.

    Raises:
        UniconError: there is no such state, or it is not of float32.
    """
    found = {}
    for name in names:
        view = states[name]
        if view.dtype != np.float32:
            raise UniconError(f"state {name!r} is {view.dtype}; float32 ones are kept alone")
        start = states.offset(name)
        found[name] = slice(start, start + view.size)
    return found


class Keeper:
    """Writes the states of rollouts, a file each.

    Args:
        folder: that the files go to, made as needed.
        names: of the states.
    """

    def __init__(self, folder: Path, names: Iterable[str]) -> None:
        self._folder, self._names = folder, tuple(names)

    def __call__(self, name: str, program: Program, rollout: Rollout) -> None:
        """Write `NAME.npz`, whole or not at all: states as float32, shape (ticks, elements).

        Raises:
            UniconError: it cannot be written.
        """
        places = columns_of(program.states, self._names)
        arrays: dict[str, Any] = {key: rollout.states[:, place] for key, place in places.items()}
        arrays |= {"dt": program.period, "joint_names": np.array(program.robot.joint_names)}
        arrays |= {"robot": program.robot.name, "workflow": program.name}
        content = io.BytesIO()
        np.savez(content, platform=program.platform.facts.name, **arrays)
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UniconError(f"cannot write in {self._folder}: {error.strerror}") from error
        write_file(self._folder / f"{name}.npz", content.getvalue())
