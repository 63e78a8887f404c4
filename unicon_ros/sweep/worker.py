"""Worker: a process that runs rows of a sweep, one after the other (`python -m`, see `local`).

It reads its task and then rows from one pipe, a line of JSON each, and writes a line of JSON for
each row to another. What engines print goes to the log that its parent made. It has one thread, and
keeps models, networks and graphs from row to row.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from unicon_core.errors import MissingDependencyError, UniconError, WorkflowError
from unicon_core.located_yaml import read_yaml
from unicon_core.runtime.rollouts import Look, Rollout
from unicon_core.states import States
from unicon_core.workflow import Program
from unicon_ros.sweep.figures import FallLook, Reference, empty_row
from unicon_ros.sweep.kept_states import Keeper
from unicon_ros.sweep.piped import line_of
from unicon_ros.sweep.plan import document_with
from unicon_ros.sweep.warm import Kept, WarmPrograms

__all__ = ["RowRunner", "Tell", "serve"]

Tell = Callable[[dict[str, Any]], None]
"""Tells the parent something, while a row runs too."""


class RowRunner:
    """Runs rows.

    Args:
        task: `workflow` (file), `duration`, `stops_at_fall` and `reference` (file or None); where
            states are kept, `keep`: their `folder` and the names of the `states`.
        said: an error, as the row of a refused rollout has it.

    Raises:
        UniconError: a file cannot be read.
    """

    def __init__(self, task: dict[str, Any], said: Callable[[object], str] = str) -> None:
        self._said = said
        self._located = read_yaml(Path(task["workflow"]), WorkflowError)
        reference = task["reference"]
        told = None if reference is None else Reference(Path(reference))
        self.programs = WarmPrograms(self.look, told)
        self._stops = bool(task["stops_at_fall"])
        self._duration = float(task["duration"])
        keep = task.get("keep")
        self._keep = None if keep is None else Keeper(Path(keep["folder"]), keep["states"])
        self._told: set[str] = set()

    def __call__(self, settings: list[str], name: str = "") -> dict[str, Any]:
        """Return `row` of some settings; where a program is new, also its `facts`.

        Args:
            settings: texts of `--set`.
            name: of the file with its states, where they are kept.

        Raises:
            MissingDependencyError: what it needs is not installed.
            UniconError: its states cannot be written.
        """
        try:
            document = document_with(self._located, settings)
            kept, rollout = self.programs.run(document, self._duration)
        except MissingDependencyError:
            raise  # it is so of every row
        except UniconError as error:
            return {"row": empty_row() | {"outcome": "refused", "text": self._said(error)[:300]}}
        if self._keep is not None:
            self._keep(name, kept.rollouts.program, rollout)
        return self.of(kept, rollout)

    def look(self, program: Program) -> Callable[[States], Look] | None:
        """Return what makes looks at the rollouts of a program that was just built."""
        return (lambda states: FallLook(states, program.period)) if self._stops else None

    def of(self, kept: Kept, rollout: Rollout) -> dict[str, Any]:
        """Return what is told of a rollout."""
        result: dict[str, Any] = {"row": kept.figures(rollout) | {"program": kept.sha256}}
        if kept.sha256 not in self._told:
            self._told.add(kept.sha256)
            result["facts"] = {kept.sha256: kept.facts | {"period_s": repr(kept.period)}}
        return result

    def told(self, settings: list[str], name: str = "") -> dict[str, Any]:
        """Return what is told of a row: as above with `built` and `why_not`, or an `error`."""
        try:
            programs = self.programs
            return self(settings, name) | {"built": programs.built, "why_not": programs.why_not}
        except UniconError as error:
            return {"error": self._said(error)}


def serve(make: Callable[[dict[str, Any], Tell], RowRunner]) -> int:
    """Run rows until the pipe ends.

    Args:
        make: makes what runs them, of the task.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's
    incoming, outgoing = (int(text) for text in sys.argv[1:3])
    with os.fdopen(incoming, "rb") as rows, os.fdopen(outgoing, "wb", buffering=0) as results:

        def tell(value: dict[str, Any]) -> None:
            results.write(line_of(value))

        runner = None
        for line in rows:
            task = json.loads(line)
            if runner is not None:
                told = runner.told(task["settings"], task["name"])
            else:
                try:
                    runner = make(task, tell)
                    continue
                except UniconError as error:
                    told = {"error": str(error)}
            tell(told)
    return 0


if __name__ == "__main__":
    sys.exit(serve(lambda task, tell: RowRunner(task)))
