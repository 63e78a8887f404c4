"""Worker: a process that runs rows of a sweep, one or some at a time (`python -m`, see `engines`).

It reads its task and then rows from its parent, and tells it what became of each. What engines
print goes to the log that its parent made. It has one thread, and keeps models, networks and graphs
from row to row.
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from unicon_base.errors import MissingDependencyError, UniconError, WorkflowError
from unicon_base.located_yaml import read_yaml
from unicon_core.policies.networks.onnx import share_sessions
from unicon_core.runtime.rollouts import Lockstep, Look, Rollout
from unicon_core.states import States
from unicon_core.workflow import Program
from unicon_lab.analysis.run import read_run
from unicon_lab.sweep.figures import FallLook, Keeper, empty_row
from unicon_lab.sweep.piped import Line
from unicon_lab.sweep.plan import document_with
from unicon_lab.sweep.warm import WarmProgram, WarmPrograms

Tell = Callable[[dict[str, Any]], None]
"""Tells the parent something, while a row runs too."""


class RowRunner:
    """Runs rows.

    Args:
        task: `workflow` (file), `duration`, `stops_at_fall` and `reference` (file or None); where
            states are kept, `keep`: their `folder` and the names of the `states`; `batch`, where
            more than one row is run at a time.
        said: an error, as the row of a refused rollout has it.

    Raises:
        UniconError: a file cannot be read.
    """

    def __init__(self, task: dict[str, Any], said: Callable[[object], str] = str) -> None:
        self._said = said
        self._located = read_yaml(Path(task["workflow"]), WorkflowError)
        reference = task["reference"]
        told = None if reference is None else read_run(Path(reference))
        self.batch = int(task.get("batch", 1))
        if self.batch > 1:
            share_sessions()
        self.programs = WarmPrograms(self.look, told, self.batch)
        self._stops = bool(task["stops_at_fall"])
        self._duration = float(task["duration"])
        keep = task.get("keep")
        self._keep = None if keep is None else Keeper(Path(keep["folder"]), keep["states"])
        self._told: set[str] = set()
        self._running: Lockstep[tuple[int, str, WarmProgram]] = Lockstep()

    def __call__(self, settings: list[str], name: str = "") -> dict[str, Any]:
        """Return `row` of some settings; where a program is new, also its `facts`.

        Args:
            settings: texts of `--set`.
            name: of the file with its states, where they are kept.

        Raises:
            MissingDependencyError: what it needs is not installed.
            UniconError: its states cannot be written.
        """
        refused = self.begin(0, settings, name)
        if refused is not None:
            return refused
        while not (ended := self.tick()):
            pass
        ((_, told),) = ended
        return told

    def __len__(self) -> int:
        """How many rows are running."""
        return len(self._running)

    def begin(self, index: int, settings: list[str], name: str = "") -> dict[str, Any] | None:
        """Have a row run beside the others; return what is told of it where it is refused."""
        try:
            kept = self.programs.begun(document_with(self._located, settings))
        except MissingDependencyError:
            raise  # it is so of every row
        except UniconError as error:
            return {"row": empty_row() | {"outcome": "refused", "text": self._said(error)[:300]}}
        limit = round(self._duration / kept.period)
        self._running.add((index, name, kept), kept.rollouts, limit)
        return None

    def tick(self) -> list[tuple[int, dict[str, Any]]]:
        """Run a tick of each row; return the index of each that has ended, and what is told."""
        return [
            (index, self._ended(name, kept, rollout))
            for (index, name, kept), rollout in self._running.tick()
        ]

    def _ended(self, name: str, kept: WarmProgram, rollout: Rollout) -> dict[str, Any]:
        if self._keep is not None:
            self._keep(name, kept.rollouts.program, rollout)
        told = self.of(kept, rollout)
        self.programs.keep(kept)
        return told

    def look(self, program: Program) -> Callable[[States], Look] | None:
        """Return what makes looks at the rollouts of a program that was just built."""
        stops = self._stops and program.robot.floats
        return (lambda states: FallLook(states, program.period)) if stops else None

    def of(self, kept: WarmProgram, rollout: Rollout) -> dict[str, Any]:
        """Return what is told of a rollout."""
        result: dict[str, Any] = {"row": kept.figures(rollout) | {"program": kept.sha256}}
        if kept.sha256 not in self._told:
            self._told.add(kept.sha256)
            result["facts"] = {kept.sha256: kept.facts | {"period_s": repr(kept.period)}}
        return result

    def told(self, settings: list[str], name: str = "") -> dict[str, Any]:
        """Return what is told of a row: as above with `built` and `why_not`, or an `error`."""
        try:
            return self.counted(self(settings, name))
        except UniconError as error:
            return {"error": self._said(error)}

    def counted(self, told: dict[str, Any]) -> dict[str, Any]:
        """Return what is told of a row with `built` and `why_not` of the programs so far."""
        return told | {"built": self.programs.built, "why_not": self.programs.why_not}


def serve(make: Callable[[dict[str, Any], Tell], RowRunner]) -> int:
    """Run rows until the line ends.

    Args:
        make: makes what runs them, of the task.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's
    line = Line()
    try:
        if task := line.read():
            _run(make(task, line.write), line)
    except UniconError as error:
        line.write({"error": str(error)})
        return 1
    return 0


def _run(runner: RowRunner, line: Line) -> None:
    """Run rows until none comes any more; each is told before the next one begins."""
    while not line.over or len(runner):
        for index, told in runner.tick():
            line.write(runner.counted(told) | {"index": index})
        while not line.over and len(runner) < runner.batch:
            # Waited for only where there is nothing else to do.
            if not line.connection.poll(0 if len(runner) else None) or not (row := line.read()):
                break
            refused = runner.begin(row["index"], row["settings"], row["name"])
            if refused is not None:
                line.write(runner.counted(refused) | {"index": row["index"]})


if __name__ == "__main__":
    sys.exit(serve(lambda task, tell: RowRunner(task)))
