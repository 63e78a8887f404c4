"""Worker: a process that runs rows of a sweep, one or some at a time (`python -m`, see `local`).

It reads its task and then rows from one pipe, a line of JSON each, and writes a line of JSON for
each row to another. What engines print goes to the log that its parent made. It has one thread, and
keeps models, networks and graphs from row to row.
"""

from __future__ import annotations

import json
import os
import select
import signal
import sys
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

from unicon_core.errors import MissingDependencyError, UniconError, WorkflowError
from unicon_core.located_yaml import read_yaml
from unicon_core.policies.networks.onnx import share_sessions
from unicon_core.runtime.lockstep import Lockstep
from unicon_core.runtime.rollouts import Rollout
from unicon_ros.sweep.figures import Reference, empty_row
from unicon_ros.sweep.plan import document_with
from unicon_ros.sweep.warm import Kept, WarmPrograms

__all__ = ["RowRunner", "main"]


class RowRunner:
    """Runs rows.

    Args:
        task: `workflow` (file), `duration`, `stops_at_fall` and `reference` (file or None);
            `batch`, where more than one row is run at a time.

    Raises:
        UniconError: a file cannot be read.
    """

    def __init__(self, task: dict[str, Any]) -> None:
        self._located = read_yaml(Path(task["workflow"]), WorkflowError)
        reference = task["reference"]
        told = None if reference is None else Reference(Path(reference))
        self.batch = int(task.get("batch", 1))
        if self.batch > 1:
            share_sessions()
        self.programs = WarmPrograms(task["stops_at_fall"], told, self.batch)
        self._duration = float(task["duration"])
        self._told: set[str] = set()
        self._running: Lockstep[tuple[int, Kept]] = Lockstep()

    def __call__(self, settings: list[str]) -> dict[str, Any]:
        """Return `row` of some settings; where a program is new, also its `facts`."""
        refused = self.begin(0, settings)
        if refused is not None:
            return refused
        while not (ended := self.tick()):
            pass
        ((_, told),) = ended
        return told

    def __len__(self) -> int:
        """How many rows are running."""
        return len(self._running)

    def begin(self, index: int, settings: list[str]) -> dict[str, Any] | None:
        """Have a row run beside the others; return what is told of it where it is refused."""
        try:
            kept = self.programs.begun(document_with(self._located, settings))
        except MissingDependencyError:
            raise  # it is so of every row
        except UniconError as error:
            return {"row": empty_row() | {"outcome": "refused", "text": str(error)[:300]}}
        limit = round(self._duration / kept.period)
        self._running.add((index, kept), kept.rollouts, limit)
        return None

    def tick(self) -> list[tuple[int, dict[str, Any]]]:
        """Run a tick of each row; return the index of each that has ended, and what is told."""
        return [
            (index, self._ended(kept, rollout)) for (index, kept), rollout in self._running.tick()
        ]

    def _ended(self, kept: Kept, rollout: Rollout) -> dict[str, Any]:
        result: dict[str, Any] = {"row": kept.figures(rollout) | {"program": kept.sha256}}
        if kept.sha256 not in self._told:
            self._told.add(kept.sha256)
            result["facts"] = {kept.sha256: kept.facts | {"period_s": repr(kept.period)}}
        self.programs.keep(kept)
        return result


def main() -> int:
    """Run rows until the pipe ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's
    incoming, outgoing = (int(text) for text in sys.argv[1:3])
    rows = _Lines(incoming)
    with os.fdopen(outgoing, "wb", buffering=0) as results:

        def tell(told: dict[str, Any]) -> None:
            results.write((json.dumps(told) + "\n").encode())

        task = rows.next(wait=True)
        try:
            if task:
                _run(RowRunner(json.loads(task)), rows, tell)
        except UniconError as error:
            tell({"error": str(error)})
            return 1
    return 0


def _run(runner: RowRunner, rows: _Lines, tell: Callable[[dict[str, Any]], None]) -> None:
    """Run rows until none comes any more; each is told before the next one begins."""

    def ended(index: int, told: dict[str, Any]) -> None:
        programs = runner.programs
        tell(told | {"index": index, "built": programs.built, "why_not": programs.why_not})

    while not rows.over or len(runner):
        for index, told in runner.tick():
            ended(index, told)
        while len(runner) < runner.batch and (line := rows.next(wait=not len(runner))):
            row = json.loads(line)
            refused = runner.begin(row["index"], row["settings"])
            if refused is not None:
                ended(row["index"], refused)


class _Lines:
    """Lines of a pipe, waited for only where there is nothing else to do.

    Attributes:
        over: nothing comes any more.
    """

    def __init__(self, pipe: int) -> None:
        self._pipe, self._half = pipe, b""
        self._lines: deque[bytes] = deque()
        self.over = False

    def next(self, wait: bool) -> bytes:
        """Return the next line, b"" where none is there yet, or none will come."""
        while not self._lines and not self.over:
            if not wait and not select.select([self._pipe], [], [], 0)[0]:
                return b""
            data = os.read(self._pipe, 1 << 16)
            self.over = not data
            *lines, self._half = (self._half + data).split(b"\n")
            self._lines.extend(lines)
        return self._lines.popleft() if self._lines else b""


if __name__ == "__main__":
    sys.exit(main())
