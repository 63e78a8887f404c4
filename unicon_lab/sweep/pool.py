"""Pool: hands rows to workers, and has those of a worker that died run again.

`PipedProcess` and `Line` connect a worker process of ours to its parent, with JSON each way.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, Pipe
from pathlib import Path
from typing import Any

from unicon_base import AnyDict, UniconError
from unicon_base.resources import same_modules
from unicon_core.signals import SIGNALS, signal_name
from unicon_lab.sweep.figures import empty_row
from unicon_lab.sweep.plan import Row
from unicon_ros.process_exit import LOG_BYTES, die_with_parent, last_log_line


@dataclass(frozen=True)
class Result:
    """The result of a row.

    Attributes:
        index: of the row.
        figures: as of `figures.COLUMNS`.
        facts: hash of a program that was new to its worker, to what it is made of.
        why_not: why one of the worker's programs has to be built for each row, "" for none.
    """

    index: int
    figures: AnyDict
    facts: dict[str, dict[str, str]] = field(default_factory=dict)
    why_not: str = ""


AHEAD = 2
"""Rows that a worker has, for each that it runs: that one and the next, so that it never waits."""
TRIES = 3
"""Of a row whose worker dies, or hangs."""
HOPELESS = 12
"""Workers that may die one after the other without a row done: what follows would, too."""
START_S = 120.0
"""Wall time in [s] that the first row of a worker has besides: engines compile."""
LOOK = 0.2
"""Time in [s] between two looks at signals and clocks."""
Given = tuple[Row, int]
"""A row, and the number of the attempt."""
ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)
"""Environment of a worker."""


class PoolWorker(ABC):
    """One worker and the rows that it has.

    Args:
        name: number of the worker.
        log: where to look when it has died.
        ready: it takes rows.

    Attributes:
        name, log, ready: as given.
        rows: that it has, each with how often it was tried; it runs the first, or the first ones.
    """

    def __init__(self, name: int, log: str, ready: bool = True) -> None:
        self.name, self.log, self.ready = name, log, ready
        self.rows: list[Given] = []
        self._since, self._more = time.monotonic(), START_S

    def late(self, timeout: float) -> str:
        """Return that its row takes longer than a time in [s], "" while it does not."""
        if self.rows and time.monotonic() - self._since > timeout + self._more:
            return f"no end within {timeout:g} s (timeout)"
        return ""

    def taken(self, index: int | None = None) -> int:
        """Return the index of the row that has ended, by default the first; another begins."""
        self._since, self._more = time.monotonic(), 0.0
        place = 0 if index is None else [row.index for row, _ in self.rows].index(index)
        return self.rows.pop(place)[0].index

    def give(self, given: Given) -> None:
        """Have a row run."""
        if not self.rows:
            self._since = time.monotonic()
        self.rows.append(given)
        self.send(given[0])

    @abstractmethod
    def send(self, row: Row) -> None:
        """Send it a row; a worker that has died ignores it."""

    @abstractmethod
    def heard(self) -> Iterator[AnyDict]:
        """Yield its messages about its rows, as of `RowRunner.told`.

        In their order, or each with its `index`.
        """

    @abstractmethod
    def gone(self, timeout: float) -> str:
        """Return why it is unusable, "" while it works; a row may take a time in [s]."""

    @abstractmethod
    def end(self, why: str) -> str:
        """End it; return why it did, in words."""


class Pool(ABC):
    """Workers of one kind: `local` and `batch` run rows in processes here, `ray` on a cluster.

    Args:
        count: of workers.
        timeout: wall time in [s] that a row may take.
        hopeless: workers that may die one after the other without a row done.
        batch: rows that a worker runs side by side.
    """

    def __init__(
        self, count: int, timeout: float, hopeless: int = HOPELESS, batch: int = 1
    ) -> None:
        self._count, self._timeout, self._hopeless = count, timeout * batch, hopeless
        self._batch, self._deaths = batch, 0
        self._workers: list[Any] = []

    @abstractmethod
    def start(self, name: int) -> PoolWorker:
        """Start a worker."""

    @abstractmethod
    def look(self) -> Iterable[PoolWorker]:
        """Return workers that have messages; wait for one, `LOOK` at most."""

    def run(self, rows: Iterable[Row]) -> Iterator[Result]:
        """Yield the result of each row once.

        A row whose worker dies is tried again, then reported as crashed. It ends early where a
        signal asks; what was not yielded by then was not run.

        Raises:
            UniconError: no row can be run here.
        """
        todo, again, more = iter(rows), list[Given](), True
        self._fill()
        while not SIGNALS.asked:
            for worker in self._workers:
                while self._wants(worker):
                    given = self._next(worker, again) or (next(todo, None), 1)
                    if given[0] is None:
                        more = False
                        break
                    worker.give(given)
            if not more and not again and not any(worker.rows for worker in self._workers):
                return
            for worker in self.look():
                for told in worker.heard():
                    if "error" in told:
                        raise UniconError(str(told["error"]))
                    index, self._deaths = worker.taken(told.get("index")), 0
                    yield Result(index, told["row"], told.get("facts", {}), told["why_not"])
            for worker in list(self._workers):
                if why := worker.gone(self._timeout):
                    yield from self._replace(worker, why, again)

    def _wants(self, worker: PoolWorker) -> bool:
        """Whether it takes another row; beside one that may have ended a batch, none."""
        alone = self._batch > 1 and any(tries > 1 for _, tries in worker.rows)
        return worker.ready and not alone and len(worker.rows) < AHEAD * self._batch

    def _next(self, worker: PoolWorker, again: list[Given]) -> Given | None:
        """Take the row to try again that a worker gets: what may end a batch, alone."""
        alone = self._batch > 1 and worker.rows
        places = (i for i, (_, tries) in enumerate(again) if tries == 1 or not alone)
        place = next(places, None)
        return None if place is None else again.pop(place)

    def _replace(self, worker: PoolWorker, why: str, again: list[Given]) -> Iterator[Result]:
        """End a worker, start another, and have its rows run again."""
        self._workers.remove(worker)
        why = worker.end(why)
        self._deaths += 1
        if self._deaths >= self._hopeless:
            raise UniconError(
                f"{self._deaths} workers ended one after the other, the last one so: {why}; see "
                f"{worker.log}"
            )
        for place, (row, tries) in enumerate(worker.rows):
            running = place < self._batch  # those behind were not at fault
            if not running or tries < TRIES:
                again.append((row, tries + running))
            else:
                crashed = {"outcome": "crashed", "text": f"{tries} times: {why}"[:300]}
                yield Result(row.index, empty_row() | crashed)
        self._fill()

    def _fill(self) -> None:
        names = {worker.name for worker in self._workers}
        self._workers += [self.start(name) for name in range(self._count) if name not in names]

    def close(self) -> None:
        """End all workers."""
        while self._workers:
            self._workers.pop().end("")


class Line:
    """One end of the connection between a process and its parent.

    Args:
        connection: to the other end; by default that of a process which a `PipedProcess` has begun.

    Attributes:
        connection: the same, for `multiprocessing.connection.wait`.
        over: the other end is closed.
    """

    def __init__(self, connection: Connection | None = None) -> None:
        self.connection = connection or Connection(int(sys.argv[1]))
        self.over = False

    def write(self, value: AnyDict) -> None:
        """Send something to the other end; one that has died ignores it."""
        with suppress(ConnectionError):
            self.connection.send_bytes(json.dumps(value, default=str).encode())

    def read(self) -> AnyDict:
        """Return the next message; wait until there is one, {} at its end."""
        with suppress(EOFError, OSError):
            value: AnyDict = json.loads(self.connection.recv_bytes())
            return value
        self.over = True
        return {}


class PipedProcess(Line):
    """A process that ends with us; what it prints goes to a log.

    Args:
        module: that it runs, with the number of a descriptor: see `Line`.
        log: file for what it prints.
        environment: of the process, besides ours.

    Attributes:
        pid: of the process.
        log: the same.
    """

    def __init__(self, module: str, log: Path, environment: Mapping[str, str]) -> None:
        ours, theirs = Pipe()
        super().__init__(ours)
        self.log = log
        try:
            with theirs, log.open("wb") as file:
                self._process = subprocess.Popen(
                    [sys.executable, "-m", module, str(theirs.fileno())],
                    stdin=subprocess.DEVNULL,
                    stdout=file,
                    stderr=file,
                    pass_fds=[theirs.fileno()],
                    env={**same_modules(), **environment},
                    start_new_session=True,  # Ctrl-C is ours
                    preexec_fn=die_with_parent if sys.platform == "linux" else None,
                )
        except BaseException:
            ours.close()
            raise
        self.pid = self._process.pid

    def heard(self) -> Iterator[AnyDict]:
        """Yield the next message, once there is one; nothing at its end."""
        if told := self.read():
            yield told

    def flooded(self) -> str:
        """Return that it printed more than a log may have, "" while it did not."""
        flood = self.log.stat().st_size > LOG_BYTES
        return f"printed more than {LOG_BYTES // 1_000_000} MB" if flood else ""

    def end(self, patience: float = 0.0, *, ask: bool = False) -> str:
        """End it; return how it did, in words.

        Args:
            patience: time in [s] within which it may end by itself.
            ask: for that by SIGTERM.
        """
        if ask:
            self._process.terminate()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(patience)
        with suppress(ProcessLookupError):  # also what it started, and what is stopped
            os.killpg(self.pid, signal.SIGKILL)
        status = self._process.wait()
        self.connection.close()
        how = f"ended by {signal_name(-status)}" if status < 0 else f"exit status {status}"
        return f"{how}: {last_log_line(self.log)}"
