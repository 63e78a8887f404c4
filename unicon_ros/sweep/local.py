"""Engines `local` and `batch`: processes on this machine, each of one thread and kept warm."""

from __future__ import annotations

import selectors
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from unicon_ros.ending import LOG_BYTES
from unicon_ros.sweep.piped import PipedProcess
from unicon_ros.sweep.plan import Row
from unicon_ros.sweep.pool import LOOK, ONE_THREAD, Pool, PoolWorker


class LocalEngine(Pool):
    """Runs rows in processes.

    Args:
        task: as of `worker.RowRunner`.
        workers: processes.
        timeout: wall time in [s] that a row may take.
        logs: folder for what engines print.
        batch: rows that a process runs side by side; see `Lockstep`.
    """

    def __init__(
        self, task: dict[str, Any], workers: int, timeout: float, logs: Path, batch: int = 1
    ) -> None:
        super().__init__(workers, timeout, batch=batch)
        self._task, self._logs = task | {"batch": batch}, logs
        self._selector = selectors.DefaultSelector()

    @property
    def pids(self) -> list[int]:
        """Process ids of the workers that run."""
        return [worker.process.pid for worker in self._workers]

    def start(self, name: int) -> PoolWorker:
        """Start a process."""
        log = self._logs / f"worker_{name}.log"
        return _Worker(name, self._task, log, self._selector)

    def look(self) -> Iterable[PoolWorker]:
        """Return workers whose pipes have something."""
        return [key.data for key, _ in self._selector.select(LOOK)]

    def close(self) -> None:
        """End all workers."""
        super().close()
        self._selector.close()


class _Worker(PoolWorker):
    """One process.

    Args:
        name: number of it.
        task: that it begins with.
        log: file for what it prints.
        selector: to look at what it tells, until its end.
    """

    def __init__(
        self, name: int, task: dict[str, Any], log: Path, selector: selectors.BaseSelector
    ) -> None:
        super().__init__(name)
        self.log = str(log)
        self.process = PipedProcess("unicon_ros.sweep.worker", log, ONE_THREAD)
        self.process.write(task)
        self._selector = selector
        selector.register(self.process.results, selectors.EVENT_READ, self)

    def send(self, row: Row) -> None:
        """Bring it a row."""
        self.process.write({"index": row.index, "settings": row.settings, "name": row.name})

    def heard(self) -> Iterator[dict[str, Any]]:
        """Yield what it has told."""
        return self.process.heard()

    def gone(self, timeout: float) -> str:
        """Return why it is of no use any more, "" while it is."""
        if self.process.over:
            return "ended"
        if self.process.log.stat().st_size > LOG_BYTES:
            return f"printed more than {LOG_BYTES // 1_000_000} MB"
        return self.late(timeout)

    def end(self, why: str) -> str:
        """End it; return why it did, in words."""
        self._selector.unregister(self.process.results)
        how = self.process.end()
        return how if why == "ended" else why
