"""Engines by name, as `unicon sweep --engine` has them: processes here, or a Ray cluster."""

from __future__ import annotations

import importlib.util
import os
import secrets
import select
import shutil
import socket
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import wait
from pathlib import Path

from unicon_base import AnyDict, MissingDependencyError, UniconError, alternatives
from unicon_core.signals import SIGNALS
from unicon_lab.sweep.folder import locked
from unicon_lab.sweep.on_ray.shipment import files_of, manifest, pack
from unicon_lab.sweep.plan import Plan, Row
from unicon_lab.sweep.pool import LOOK, ONE_THREAD, PipedProcess, Pool, PoolWorker, Result
from unicon_ros.process_exit import last_log_line

JOIN_S, START_S = 60.0, 120.0
"""Wall time in [s] until a cluster takes us (1 s on two nodes), and until our own is up (5 s)."""
TCP_S = 5.0
"""Wall time in [s] until a head node answers."""
BEAT_S = 2.0
"""Time in [s] between two looks at the head node."""
MISSES = 3
"""Looks at the head node without an answer: it is lost."""
END_S = 10.0
"""Wall time in [s] that Ray has to end by itself; 0.5 to 2 s."""
LOG = "ray.log"
LOOPBACK = ("127.0.0.1", "localhost")


def require_ray() -> None:
    """Say before the work that there is no Ray.

    Raises:
        MissingDependencyError: it is not installed.
    """
    if importlib.util.find_spec("ray") is None:
        raise MissingDependencyError(
            "unicon sweep --engine ray", "ray", "pip install 'unicon_ros[ray]'"
        )


class RayEngine:
    """Runs rows on a cluster.

    Args:
        plan: of the sweep.
        workers: actors at most, None for one on each CPU.
        left: rows that are not done.
        logs: folder for what Ray prints.
        address: of a head node, "" for a Ray of our own.

    Raises:
        UniconError: there is no such cluster, or what the rows read cannot be shipped.
    """

    def __init__(
        self, plan: Plan, workers: int | None, left: int, logs: Path, address: str = ""
    ) -> None:
        require_ray()
        self._address, self._log = address, logs / LOG
        try:
            self._scratch = Scratch()
        except OSError as error:
            raise UniconError(
                f"cannot write in {error.filename}: {error.strerror}; make room, or set TMPDIR"
            ) from error
        self._process: PipedProcess | None = None
        self._done = False
        self._head, self._misses, self._next_beat = address, 0, 0.0
        try:
            environment = environment_for(address)
            archive = self._scratch.path / "rows.zip"
            pack(archive, files_of(plan, self._log))
            self._process = PipedProcess("unicon_lab.sweep.on_ray.driver", self._log, environment)
            self._process.write(
                {
                    "address": address,
                    "archive": str(archive),
                    "folder": str(self._scratch.path),
                    "left": left,
                    "log": str(self._log),
                    "manifest": manifest(plan.task()),
                    "timeout": plan.sweep.said.timeout,
                    "workers": workers or (None if address else len(os.sched_getaffinity(0))),
                }
            )
        except BaseException:
            self.close()
            raise

    def run(self, rows: Iterable[Row]) -> Iterator[Result]:
        """Yield the result of each row; see `Engine`."""
        assert self._process is not None
        process, todo = self._process, iter(rows)
        line, ready, more = process.connection, False, True
        patience = JOIN_S if self._address else START_S
        until = time.monotonic() + patience
        while not SIGNALS.asked:
            told_any, takes, _ = select.select([line], [line] if more else [], [], LOOK)
            if takes:  # {} says that no more comes
                row = next(todo, None)
                more = row is not None
                process.write({"index": row.index, "settings": row.settings} if row else {})
            for told in process.heard() if told_any else ():
                if "error" in told:
                    raise UniconError(str(told["error"]))
                if "ready" in told:
                    ready, self._head = True, str(told["head"])
                elif "done" in told:
                    self._done = True
                else:
                    yield Result(**told)
            if self._done:
                return
            if process.over and not ready:
                raise UniconError(
                    f"ray: Ray did not start: {last_log_line(self._log)}; mend it (all that it "
                    f"said is in {self._log}), or try --engine local"
                )
            if process.over:
                raise self._lost("Ray has ended")
            if not ready and time.monotonic() > until:
                what = f"--address {self._address}: no Ray cluster" if self._address else "ray: Ray"
                raise UniconError(
                    f"{what} has answered within {patience:g} s; what it said is in {self._log}"
                )
            if ready:
                self._mind_head()

    def _mind_head(self) -> None:
        """Look whether the head node is there: without it Ray waits for a minute, then dies."""
        now = time.monotonic()
        if now < self._next_beat:
            return
        self._next_beat = now + BEAT_S
        self._misses = 0 if _refusal(self._head) == "" else self._misses + 1
        if self._misses >= MISSES:
            raise self._lost("it does not answer")

    def _lost(self, why: str) -> UniconError:
        where = f"Ray's head node at {self._address}" if self._address else "the local Ray"
        return UniconError(
            f"{where} is lost: {why}; what is done is written (and what Ray said is in "
            f"{self._log}): run the same command again to go on"
        )

    def close(self) -> None:
        """End the driver, and with it its actors and a Ray that is our own."""
        if self._process is not None:
            here = self._misses < MISSES
            self._process.end(END_S if here else 0.0, ask=here and not self._done)
            self._process = None
        self._scratch.close()


def environment_for(address: str) -> Mapping[str, str]:
    """Return what Ray's driver has in its environment: it tells nobody of us, and minds loopback.

    Ray takes 127.0.0.1 for the address that this machine has in its network, and opens ports there.
    The variable, which is meant for other systems, has it take 127.0.0.1 for what it is.

    Args:
        address: of a head node, "" for a Ray of our own.

    Raises:
        UniconError: nobody is there.
    """
    outside = {"RAY_USAGE_STATS_ENABLED": "0"}
    inside = outside | {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0"}
    if not address:  # nobody else gets in, and Ray writes no token into the user's home
        return inside | {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32)}
    host, _, port = address.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536 or "/" in host:
        raise UniconError(
            f"--address {address!r}: give HOST:PORT of a Ray head node, such as 127.0.0.1:6379, on "
            "a machine that is a node of the cluster"
        )
    why = _refusal(address)
    if why:
        raise UniconError(
            f"--address {address}: no Ray cluster is there ({why}); start one with ray start "
            "--head, or leave --address out"
        )
    if host in LOOPBACK and _refusal(f"{_own_address()}:{port}"):
        return inside
    return outside


def _refusal(address: str) -> str:
    """Return why nobody takes a connection at HOST:PORT, "" where somebody does."""
    host, _, port = address.rpartition(":")
    try:
        socket.create_connection((host, int(port)), TCP_S).close()
    except OSError as error:
        return error.strerror or str(error)
    return ""


def _own_address() -> str:
    """Return the address of this machine in its network, as Ray finds it: nothing is sent."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as outward, suppress(OSError):
        outward.connect(("8.8.8.8", 80))
        return str(outward.getsockname()[0])
    return "127.0.0.1"


PREFIX = "unicon_ray_"


class Scratch:
    """A folder in that of temporary files; those of processes that have died are removed.

    Its name is short: a name of a socket has 107 bytes at most on Linux, and Ray adds 70.

    Attributes:
        path: of the folder.
    """

    def __init__(self) -> None:
        for old in Path(tempfile.gettempdir()).glob(f"{PREFIX}*"):
            with suppress(OSError), locked(old):
                shutil.rmtree(old, ignore_errors=True)
        made = Path(tempfile.mkdtemp(prefix=""))
        self._lock = locked(made)  # before another process can find it by its name
        self.path = made.rename(made.with_name(PREFIX + made.name))

    def close(self) -> None:
        """Remove it; safe to call twice."""
        shutil.rmtree(self.path, ignore_errors=True)
        self._lock.close()


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


def engine_of(plan: Plan, wish: Wish, left: int, folder: Path) -> LocalEngine | RayEngine:
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
        self, task: AnyDict, workers: int, timeout: float, logs: Path, batch: int = 1
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

    def __init__(self, name: int, task: AnyDict, log: Path) -> None:
        super().__init__(name, str(log))
        self.process = PipedProcess("unicon_lab.sweep.worker", log, ONE_THREAD)
        self.process.write(task)

    def send(self, row: Row) -> None:
        """Bring it a row."""
        self.process.write({"index": row.index, "settings": row.settings, "name": row.name})

    def heard(self) -> Iterator[AnyDict]:
        """Yield what it has told."""
        return self.process.heard()

    def gone(self, timeout: float) -> str:
        """Return why it is of no use any more, "" while it is."""
        if self.process.over:
            return "ended"
        return self.process.flooded() or self.late(timeout)

    def end(self, why: str) -> str:
        """End it; return why it did, in words."""
        how = self.process.end()
        return how if why == "ended" else why
