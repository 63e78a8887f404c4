"""Engine `local`: a pool of processes on this machine, each of one thread and kept warm."""

from __future__ import annotations

import json
import os
import selectors
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from unicon_core.errors import UniconError
from unicon_core.resources import same_modules
from unicon_core.signals import SIGNALS, signal_name
from unicon_ros.bench.loops import die_with_parent
from unicon_ros.last_words import LOG_BYTES, last_words
from unicon_ros.sweep.engine import Result
from unicon_ros.sweep.figures import empty_row
from unicon_ros.sweep.plan import Row

__all__ = ["LocalEngine"]

AHEAD = 2
"""Rows that a worker has: the one that it runs, and the next, so that it never waits."""
TRIES = 3
"""Of a row whose worker dies, or hangs."""
HOPELESS = 12
"""Workers that may die one after the other without a row done: what follows would, too."""
START_S = 120.0
"""Wall time in [s] that the first row of a worker has besides: engines compile."""
LOOK = 0.2
"""Time in [s] between two looks at signals and clocks."""
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


class LocalEngine:
    """Runs rows in processes.

    Args:
        task: as of `worker.RowRunner`.
        workers: processes.
        timeout: wall time in [s] that a row may take.
        logs: folder for what engines print.
    """

    def __init__(self, task: dict[str, Any], workers: int, timeout: float, logs: Path) -> None:
        self._task, self._count, self._timeout, self._logs = task, workers, timeout, logs
        self._selector = selectors.DefaultSelector()
        self._workers: list[_Worker] = []
        self._deaths = 0

    @property
    def pids(self) -> list[int]:
        """Process ids of the workers that run."""
        return [worker.process.pid for worker in self._workers]

    def run(self, rows: Iterable[Row]) -> Iterator[Result]:
        """Yield the result of each row; see `Engine`."""
        todo = iter(rows)
        again: deque[tuple[Row, int]] = deque()
        more = True
        self._fill(self._count)
        while not SIGNALS.asked:
            for worker in self._workers:
                while len(worker.rows) < AHEAD:
                    if again:
                        worker.give(*again.popleft())
                    elif more and (row := next(todo, None)) is not None:
                        worker.give(row, 1)
                    else:
                        more = False
                        break
            if not more and not again and not any(worker.rows for worker in self._workers):
                return
            for key, _ in self._selector.select(LOOK):
                worker = key.data
                for told in worker.heard():
                    if "error" in told:
                        raise UniconError(str(told["error"]))
                    row, _ = worker.taken()
                    self._deaths = 0
                    yield Result(
                        row.index,
                        told["row"],
                        told.get("facts", {}),
                        told["built"],
                        told["why_not"],
                    )
            for worker in list(self._workers):
                if why := worker.gone(self._timeout):
                    yield from self._replace(worker, why, again)

    def _replace(
        self, worker: _Worker, why: str, again: deque[tuple[Row, int]]
    ) -> Iterator[Result]:
        """End a worker, start another, and have its rows run again."""
        self._selector.unregister(worker.results)
        self._workers.remove(worker)
        why = worker.end(why)
        self._deaths += 1
        if self._deaths >= HOPELESS:
            raise UniconError(
                f"{self._deaths} workers ended one after the other, the last one so: {why}; see "
                f"{worker.log}"
            )
        for place, (row, tries) in enumerate(worker.rows):
            if place:  # it was not at fault
                again.append((row, tries))
            elif tries < TRIES:
                again.append((row, tries + 1))
            else:
                crashed = {"outcome": "crashed", "text": f"{tries} times: {why}"[:300]}
                yield Result(row.index, empty_row() | crashed)
        self._fill(self._count)

    def _fill(self, count: int) -> None:
        names = {worker.name for worker in self._workers}
        for name in range(count):
            if name not in names:
                worker = _Worker(name, self._task, self._logs / f"worker_{name}.log")
                self._workers.append(worker)
                self._selector.register(worker.results, selectors.EVENT_READ, worker)

    def close(self) -> None:
        """End all workers."""
        for worker in self._workers:
            worker.end("")
        self._workers.clear()
        self._selector.close()


class _Worker:
    """One process.

    Args:
        name: number of it.
        task: that it begins with.
        log: file for what it prints.
    """

    def __init__(self, name: int, task: dict[str, Any], log: Path) -> None:
        self.name, self.log = name, log
        self.rows: deque[tuple[Row, int]] = deque()
        self._since = time.monotonic()
        self._more = START_S
        self._heard = b""
        self._over = False
        theirs, ours = os.pipe()
        self.results, told = os.pipe()
        try:
            with log.open("wb") as file:
                self.process = subprocess.Popen(
                    [sys.executable, "-m", "unicon_ros.sweep.worker", str(theirs), str(told)],
                    stdin=subprocess.DEVNULL,
                    stdout=file,
                    stderr=file,
                    pass_fds=[theirs, told],
                    env=same_modules() | dict.fromkeys(ONE_THREAD, "1"),
                    start_new_session=True,  # Ctrl-C is ours
                    preexec_fn=die_with_parent if sys.platform == "linux" else None,
                )
        except BaseException:
            os.close(ours)
            os.close(self.results)
            raise
        finally:
            os.close(theirs)
            os.close(told)
        self._rows_to = ours
        self._write(task)

    def give(self, row: Row, tries: int) -> None:
        """Have a row run, for the so many-th time."""
        if not self.rows:
            self._since = time.monotonic()
        self.rows.append((row, tries))
        self._write({"index": row.index, "settings": row.settings})

    def _write(self, value: dict[str, Any]) -> None:
        data = (json.dumps(value) + "\n").encode()
        with suppress(BrokenPipeError):  # it has died: `gone` tells
            while data:
                data = data[os.write(self._rows_to, data) :]

    def heard(self) -> Iterator[dict[str, Any]]:
        """Yield what it has told."""
        data = os.read(self.results, 1 << 16)
        self._over = not data
        *lines, self._heard = (self._heard + data).split(b"\n")
        yield from map(json.loads, lines)

    def taken(self) -> tuple[Row, int]:
        """Return the row that has ended; the next one begins."""
        self._since, self._more = time.monotonic(), 0.0
        return self.rows.popleft()

    def gone(self, timeout: float) -> str:
        """Return why it is of no use any more, "" while it is."""
        if self._over:
            return "ended"
        if self.rows and time.monotonic() - self._since > timeout + self._more:
            return f"no end within {timeout:g} s (timeout)"
        if self.log.stat().st_size > LOG_BYTES:
            return f"printed more than {LOG_BYTES // 1_000_000} MB"
        return ""

    def end(self, why: str) -> str:
        """End it; return why it did, in words."""
        with suppress(ProcessLookupError):  # also what it started, and what is stopped
            os.killpg(self.process.pid, signal.SIGKILL)
        status = self.process.wait()
        os.close(self._rows_to)
        os.close(self.results)
        if why != "ended":
            return why
        how = f"ended by {signal_name(-status)}" if status < 0 else f"exit status {status}"
        return f"{how}: {last_words(self.log)}"
