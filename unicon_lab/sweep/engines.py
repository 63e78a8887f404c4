"""Engines by name, as `unicon sweep --engine` has them; those with processes of this machine."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any

from unicon_base.errors import UniconError, alternatives
from unicon_lab.sweep.on_ray.engine import RayEngine, require_ray
from unicon_lab.sweep.plan import Plan, Row
from unicon_lab.sweep.pool import LOOK, ONE_THREAD, Engine, PipedProcess, Pool, PoolWorker
from unicon_lab.sweep.sweep_file import SweepFile
from unicon_ros.process_exit import LOG_BYTES

ENGINES = ("local", "batch", "ray")
BATCH = 4
"""Rows that `batch` runs side by side, unless told: eight Go2 do not fit into 1 MB of cache."""


@dataclass(frozen=True)
class Wish:
    """What is asked for.

    Attributes:
        engine: its name.
        workers: processes, or actors; None for one on each core.
        batch: rows side by side in each process; None where nobody says.
        address: of the head node of a Ray cluster, "" for a Ray of our own.

    Raises:
        UniconError: there is no such engine, or it has no batches or no address.
    """

    engine: str = "local"
    workers: int | None = None
    batch: int | None = None
    address: str = ""

    def __post_init__(self) -> None:
        if self.engine not in ENGINES:
            raise UniconError(f"--engine {self.engine!r}; {alternatives(self.engine, ENGINES)}")
        if self.batch is not None and self.engine != "batch":
            raise UniconError(
                f"--batch {self.batch}: engine {self.engine!r} runs one row at a time in each "
                "process; add --engine batch"
            )
        if self.address and self.engine != "ray":
            raise UniconError("--address is of a Ray cluster; add --engine ray")

    def check(self, sweep: SweepFile) -> None:
        """Say before the work what the engine cannot do for a sweep.

        Raises:
            UniconError: states are to be kept, and rows run on other machines.
        """
        if sweep.keep and self.engine == "ray":
            raise UniconError(
                f"{sweep.path}: keep is of engine local or batch; take it out, or --engine local"
            )

    def require(self) -> None:
        """Say before the work that the engine is absent.

        Raises:
            MissingDependencyError: it is not installed.
        """
        if self.engine == "ray":
            require_ray()


def engine_of(plan: Plan, wish: Wish, left: int, folder: Path) -> Engine:
    """Return an engine that runs rows of a plan.

    Args:
        plan: of the sweep.
        wish: what is asked for.
        left: rows that are not done.
        folder: of the sweep, for logs and for states that are kept.
    """
    if wish.engine == "ray":
        return RayEngine(plan, wish.workers, left, folder, wish.address)
    count = min(wish.workers or len(os.sched_getaffinity(0)), left)
    batch = wish.batch or BATCH if wish.engine == "batch" else 1
    return LocalEngine(plan.task(folder), count, plan.sweep.said.timeout, folder, batch)


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

    @property
    def pids(self) -> list[int]:
        """Process ids of the workers that run."""
        return [worker.process.pid for worker in self._workers]

    def start(self, name: int) -> PoolWorker:
        """Start a process."""
        return _Worker(name, self._task, self._logs / f"worker_{name}.log")

    def look(self) -> Iterable[PoolWorker]:
        """Return workers whose pipes have something."""
        told = wait([worker.process.connection for worker in self._workers], LOOK)
        return [each for each in self._workers if each.process.connection in told]


class _Worker(PoolWorker):
    """One process.

    Args:
        name: number of it.
        task: that it begins with.
        log: file for what it prints.
    """

    def __init__(self, name: int, task: dict[str, Any], log: Path) -> None:
        super().__init__(name)
        self.log = str(log)
        self.process = PipedProcess("unicon_lab.sweep.worker", log, ONE_THREAD)
        self.process.write(task)

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
        how = self.process.end()
        return how if why == "ended" else why
