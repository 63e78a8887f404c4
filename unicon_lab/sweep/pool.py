"""Engines are pools: they hand rows to workers, and have those of a worker that died run again."""

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
from typing import Any, Protocol

from unicon_base.errors import UniconError
from unicon_base.resources import same_modules
from unicon_core.signals import SIGNALS, signal_name
from unicon_lab.sweep.figures import empty_row
from unicon_lab.sweep.plan import Row
from unicon_ros.process_exit import die_with_parent, last_log_line


@dataclass(frozen=True)
class Result:
    """What became of a row.

    Attributes:
        index: of the row.
        figures: as of `figures.COLUMNS`.
        facts: hash of a program that was new to its worker, to what it is made of.
        built: programs that this worker has built so far.
        why_not: why one of them has to be built for each row, "" for none.
    """

    index: int
    figures: dict[str, Any]
    facts: dict[str, dict[str, str]] = field(default_factory=dict)
    built: int = 0
    why_not: str = ""


class Engine(Protocol):
    """Runs rows somewhere: `local` and `batch` in processes here, `ray` on a cluster."""

    def run(self, rows: Iterable[Row]) -> Iterator[Result]:
        """Yield the result of each row once.

        A row whose worker dies is tried again, then told as crashed. It ends early where a signal
        asks; what was not yielded by then was not run.

        Raises:
            UniconError: no row can be run here.
        """
        ...

    def close(self) -> None:
        """End whatever it has started."""
        ...


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
"""A row, and for the so many-th time."""
ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)
"""Environment of a worker."""


class PoolWorker(ABC):
    """One worker and the rows that it has.

    Args:
        name: number of it.

    Attributes:
        name: the same.
        rows: that it has, each with how often it was tried; it runs the first, or the first ones.
        ready: it takes rows.
        log: where to look when it has died.
    """

    def __init__(self, name: int) -> None:
        self.name = name
        self.rows: list[Given] = []
        self.ready = True
        self.log = ""
        self._since = time.monotonic()
        self._more = START_S

    def wants(self, batch: int) -> bool:
        """Return whether it takes another row; beside one that may have ended a batch, none."""
        alone = batch > 1 and any(tries > 1 for _, tries in self.rows)
        return self.ready and not alone and len(self.rows) < AHEAD * batch

    def give(self, row: Row, tries: int) -> None:
        """Have a row run, for the so many-th time."""
        if not self.rows:
            self._since = time.monotonic()
        self.rows.append((row, tries))
        self.send(row)

    def taken(self, index: int | None = None) -> int:
        """Return the index of the row that has ended, the first one unless told; another begins."""
        self._since, self._more = time.monotonic(), 0.0
        place = 0 if index is None else [row.index for row, _ in self.rows].index(index)
        return self.rows.pop(place)[0].index

    def late(self, timeout: float) -> str:
        """Return that its row takes longer than a time in [s], "" while it does not."""
        if self.rows and time.monotonic() - self._since > timeout + self._more:
            return f"no end within {timeout:g} s (timeout)"
        return ""

    @abstractmethod
    def send(self, row: Row) -> None:
        """Bring it a row; one that has died does not mind."""

    @abstractmethod
    def heard(self) -> Iterator[dict[str, Any]]:
        """Yield what it has told of its rows, as of `RowRunner.told`.

        In their order, or each with its `index`.
        """

    @abstractmethod
    def gone(self, timeout: float) -> str:
        """Return why it is of no use any more, "" while it is; a row may take a time in [s]."""

    @abstractmethod
    def end(self, why: str) -> str:
        """End it; return why it did, in words."""


class Pool(ABC):
    """Workers of one kind; see `Engine`.

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
        self._batch = batch
        self._workers: list[Any] = []
        self._deaths = 0

    @abstractmethod
    def start(self, name: int) -> PoolWorker:
        """Start a worker."""

    @abstractmethod
    def look(self) -> Iterable[PoolWorker]:
        """Return workers that have told something; wait for one, `LOOK` at most."""

    def run(self, rows: Iterable[Row]) -> Iterator[Result]:
        """Yield the result of each row; see `Engine`."""
        todo = iter(rows)
        again: list[Given] = []
        more = True
        self._fill()
        while not SIGNALS.asked:
            for worker in self._workers:
                while worker.wants(self._batch):
                    if (place := self._place(worker, again)) is not None:
                        worker.give(*again.pop(place))
                    elif more and (row := next(todo, None)) is not None:
                        worker.give(row, 1)
                    else:
                        more = False
                        break
            if not more and not again and not any(worker.rows for worker in self._workers):
                return
            for worker in self.look():
                for told in worker.heard():
                    if "error" in told:
                        raise UniconError(str(told["error"]))
                    index = worker.taken(told.get("index"))
                    self._deaths = 0
                    facts = told.get("facts", {})
                    yield Result(index, told["row"], facts, told["built"], told["why_not"])
            for worker in list(self._workers):
                if why := worker.gone(self._timeout):
                    yield from self._replace(worker, why, again)

    def _place(self, worker: PoolWorker, again: list[Given]) -> int | None:
        """Return which of the rows to try again a worker gets: what may end a batch, alone."""
        alone = self._batch > 1 and bool(worker.rows)
        return next((i for i, (_, tries) in enumerate(again) if tries == 1 or not alone), None)

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
            if place >= self._batch:  # it was not at fault
                again.append((row, tries))
            elif tries < TRIES:
                again.append((row, tries + 1))
            else:
                crashed = {"outcome": "crashed", "text": f"{tries} times: {why}"[:300]}
                yield Result(row.index, empty_row() | crashed)
        self._fill()

    def _fill(self) -> None:
        names = {worker.name for worker in self._workers}
        for name in range(self._count):
            if name not in names:
                self._workers.append(self.start(name))

    def close(self) -> None:
        """End all workers."""
        for worker in self._workers:
            worker.end("")
        self._workers.clear()


class Line:
    """One end of the line between a process and its parent.

    Args:
        connection: to the other end; by default that of a process which a `PipedProcess` has begun.

    Attributes:
        connection: the same, for whoever waits for it.
        over: the other end is closed.
    """

    def __init__(self, connection: Connection | None = None) -> None:
        self.connection = connection or Connection(int(sys.argv[1]))
        self.over = False

    def write(self, value: dict[str, Any]) -> None:
        """Tell the other end something; one that has died does not mind."""
        with suppress(ConnectionError):
            self.connection.send_bytes(json.dumps(value, default=str).encode())

    def read(self) -> dict[str, Any]:
        """Return what the other end has told; wait until there is something, {} at its end."""
        with suppress(EOFError, OSError):
            value: dict[str, Any] = json.loads(self.connection.recv_bytes())
            return value
        self.over = True
        return {}


class PipedProcess(Line):
    """A process that ends with us; what it prints goes to a log.

    Args:
        module: that it runs, with the number of a descriptor: see `Line`.
        log: file for what it prints.
        environment: of it, besides ours.

    Attributes:
        pid: of it.
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

    def heard(self) -> Iterator[dict[str, Any]]:
        """Yield what it has told by now, once there is something; nothing at its end."""
        if told := self.read():
            yield told

    def wait(self, patience: float, ask: bool) -> None:
        """Let it end by itself within a time in [s]; ask for it by SIGTERM."""
        if ask:
            self._process.terminate()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(patience)

    def end(self) -> str:
        """End it; return how it did, in words."""
        with suppress(ProcessLookupError):  # also what it started, and what is stopped
            os.killpg(self.pid, signal.SIGKILL)
        status = self._process.wait()
        self.connection.close()
        how = f"ended by {signal_name(-status)}" if status < 0 else f"exit status {status}"
        return f"{how}: {last_log_line(self.log)}"
