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
from unicon_ros.sweep.figures import Reference, empty_row
from unicon_ros.sweep.piped import line_of
from unicon_ros.sweep.plan import document_with
from unicon_ros.sweep.warm import WarmPrograms

__all__ = ["RowRunner", "main"]


class RowRunner:
    """Runs rows.

    Args:
        task: `workflow` (file), `duration`, `stops_at_fall` and `reference` (file or None).
        said: an error, as the row of a refused rollout has it.

    Raises:
        UniconError: a file cannot be read.
    """

    def __init__(self, task: dict[str, Any], said: Callable[[object], str] = str) -> None:
        self._said = said
        self._located = read_yaml(Path(task["workflow"]), WorkflowError)
        reference = task["reference"]
        told = None if reference is None else Reference(Path(reference))
        self.programs = WarmPrograms(task["stops_at_fall"], told)
        self._duration = float(task["duration"])
        self._told: set[str] = set()

    def __call__(self, settings: list[str]) -> dict[str, Any]:
        """Return `row` of some settings; where a program is new, also its `facts`."""
        try:
            document = document_with(self._located, settings)
            kept, rollout = self.programs.run(document, self._duration)
        except MissingDependencyError:
            raise  # it is so of every row
        except UniconError as error:
            return {"row": empty_row() | {"outcome": "refused", "text": self._said(error)[:300]}}
        result: dict[str, Any] = {"row": kept.figures(rollout) | {"program": kept.sha256}}
        if kept.sha256 not in self._told:
            self._told.add(kept.sha256)
            result["facts"] = {kept.sha256: kept.facts | {"period_s": repr(kept.period)}}
        return result

    def told(self, settings: list[str]) -> dict[str, Any]:
        """Return what is told of a row: as above with `built` and `why_not`, or an `error`."""
        try:
            programs = self.programs
            return self(settings) | {"built": programs.built, "why_not": programs.why_not}
        except UniconError as error:
            return {"error": self._said(error)}


def main() -> int:
    """Run rows until the pipe ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's
    incoming, outgoing = (int(text) for text in sys.argv[1:3])
    with os.fdopen(incoming, "rb") as rows, os.fdopen(outgoing, "wb", buffering=0) as results:
        runner = None
        for line in rows:
            task = json.loads(line)
            if runner is not None:
                told = runner.told(task["settings"])
            else:
                try:
                    runner = RowRunner(task)
                    continue
                except UniconError as error:
                    told = {"error": str(error)}
            results.write(line_of(told))
    return 0


if __name__ == "__main__":
    sys.exit(main())
