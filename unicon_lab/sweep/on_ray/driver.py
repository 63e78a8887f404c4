"""Driver: a process of its own that is Ray's driver, with a pool of actors (`python -m`).

Ray ends its driver's process where a head node is lost, and prints to its terminal: so it is not
the command's. It reads a task and then rows from the command, and tells it what became of them.
"""

from __future__ import annotations

import os
import signal
import socket
import sys
import time
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Any

from unicon_base import AnyDict, AnyMapping, UniconError, one_line
from unicon_lab.sweep.plan import Row, code_sha256, differing, versions
from unicon_lab.sweep.pool import HOPELESS, LOOK, ONE_THREAD, START_S, Line, Pool, PoolWorker


class RowActor:
    """Runs rows on a node, one after the other, in the folder that Ray has unpacked.

    Ray ships this class by value and its methods import the rest, so that `hello` or an error in
    one line reports what a node lacks.

    Args:
        manifest: as of `shipment.manifest`.
    """

    def __init__(self, manifest: AnyDict) -> None:
        self._manifest = manifest
        self._root = Path.cwd()
        self._runner: Any = None

    def hello(self) -> AnyDict:
        """Return who this is: `node`, `pid`, `code` and `versions` as of `plan`."""
        from unicon_lab.sweep.plan import code_sha256, versions

        return {
            "node": socket.gethostname(),
            "pid": os.getpid(),
            "code": code_sha256(),
            "versions": versions(),
        }

    def row(self, settings: list[str]) -> AnyDict:
        """Return what is told of a row, as of `RowRunner.told`."""
        from unicon_base import UniconError
        from unicon_lab.sweep.on_ray.shipment import arrive
        from unicon_lab.sweep.worker import RowRunner

        if self._runner is None:
            task, original = arrive(self._root, self._manifest)
            try:
                self._runner = RowRunner(task, original)
            except UniconError as error:
                return {"error": original(error)}
        told: AnyDict = self._runner.told(settings)
        return told


STORE_BYTES = 80_000_000
"""Of a local Ray's shared memory: nothing large goes through it, and it has to have 75 MB."""
LOGS = "the logs of Ray on its node, or try --engine local"


class ActorPool(Pool):
    """Actors of one CPU each.

    Args:
        ray: the module, joined to a cluster.
        manifest: as of `shipment.manifest`.
        count: of actors.
        timeout: wall time in [s] that a row may take.
    """

    def __init__(self, ray: Any, manifest: AnyDict, count: int, timeout: float) -> None:
        # A node that is lost takes all its workers at once.
        super().__init__(count, timeout, max(HOPELESS, 2 * count))
        self._ray = ray
        remote: Any = ray.remote(num_cpus=1, scheduling_strategy="SPREAD")(RowActor)
        self._remote, self._manifest = remote, manifest
        self._alone_since = time.monotonic()

    def start(self, name: int) -> PoolWorker:
        """Ask the cluster for an actor; it may wait for a CPU."""
        return _Actor(name, self._ray, self._remote.remote(self._manifest))

    def look(self) -> Iterable[PoolWorker]:
        """Return workers whose first answer has come.

        Raises:
            UniconError: no worker has come up.
        """
        waiting = {worker.answers[0]: worker for worker in self._workers if worker.answers}
        if not waiting:
            time.sleep(LOOK)
            return []
        if any(worker.ready for worker in self._workers):
            self._alone_since = time.monotonic()
        elif time.monotonic() - self._alone_since > START_S:
            raise UniconError(
                f"ray: no worker has come up within {START_S:g} s: no CPU of the cluster is free, "
                "or its nodes cannot start one; look at ray status"
            )
        answers = list(waiting)
        self._ray.wait(answers, timeout=LOOK)
        come, _ = self._ray.wait(answers, num_returns=len(answers), timeout=0)
        return [waiting[answer] for answer in come]


class _Actor(PoolWorker):
    """One actor.

    Args:
        name: number of it.
        ray: the module.
        actor: handle of it.

    Attributes:
        answers: that it owes, in order.
    """

    def __init__(self, name: int, ray: Any, actor: Any) -> None:
        super().__init__(name, LOGS, ready=False)
        self._ray, self._actor = ray, actor
        self.answers: deque[Any] = deque([actor.hello.remote()])
        self._node = self._why = ""

    def send(self, row: Row) -> None:
        """Bring it a row."""
        self.answers.append(self._actor.row.remote(row.settings))

    def heard(self) -> Iterator[AnyDict]:
        """Yield its first answer."""
        try:
            told = self._ray.get(self.answers[0])
        except self._ray.exceptions.RayTaskError as error:
            self._why = f"exit status 1: {_last_line(error)}"
        except self._ray.exceptions.RayError as error:
            self._why = _last_line(error) if not self.ready else f"ended on node {self._node}"
        else:
            self.answers.popleft()
            if self.ready:
                yield told
                return
            self.ready, self._node = True, str(told["node"])
            if wrong := differs(told):
                yield {"error": f"ray: node {self._node} {wrong}"}

    def gone(self, timeout: float) -> str:
        """Return why it is of no use any more, "" while it is."""
        return self._why or self.late(timeout)

    def end(self, why: str) -> str:
        """Kill it; one that is stopped ends 5 s later."""
        self._ray.kill(self._actor)
        return why


def _last_line(error: BaseException) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[-1][:300] if lines else type(error).__name__


def differs(told: AnyMapping) -> str:
    """Return how what a worker runs differs from what we have, and what to do; "" if it does not.

    Args:
        told: as of `RowActor.hello`.
    """
    found = differing(told["versions"], versions())
    if pairs := ", ".join(f"{name} {theirs} (here {ours})" for name, theirs, ours in found):
        return f"has {pairs}: rows would differ; install the same there"
    if told["code"] != code_sha256():
        return (
            "runs other code of unicon_ros than was shipped: rows would differ; take unicon_ros "
            "out of PYTHONPATH there"
        )
    return ""


def _rows(line: Line) -> Iterator[Row]:
    while said := line.read():
        yield Row(said["index"], 0, (), tuple(said["settings"]))


def _joined(task: AnyDict) -> Any:
    """Join a cluster, or start one on this machine; return the module of Ray.

    Raises:
        UniconError: there is none, or it refuses.
    """
    try:
        import ray
    except ImportError as error:
        raise UniconError(
            f"ray cannot be imported: {error}; pip install 'unicon_ros[ray]' mends it"
        ) from error
    cluster: AnyDict = (
        {"address": task["address"]}
        if task["address"]
        else {
            "address": "local",
            "num_cpus": task["workers"],
            "include_dashboard": False,
            "object_store_memory": STORE_BYTES,
            "_node_ip_address": "127.0.0.1",
            "_temp_dir": task["folder"],
        }
    )
    try:
        ray.init(
            **cluster,
            runtime_env={"working_dir": task["archive"], "env_vars": ONE_THREAD},
            log_to_driver=False,
            logging_level="ERROR",
        )
    except Exception as error:  # whatever a cluster of another kind or version makes of it
        said = one_line(error)[:300]
        if task["address"]:
            said += "; a cluster that has tokens wants RAY_AUTH_MODE=token here, too"
        raise UniconError(f"ray: {said}; what Ray said is in {task['log']}") from error
    return ray


def main() -> None:
    """Run rows until there are no more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the command's
    line = Line()
    task = line.read()
    with ExitStack() as after:  # the error comes first: Ray's end may be ours
        try:
            ray = _joined(task)
            count = min(task["workers"] or int(ray.cluster_resources().get("CPU", 0)), task["left"])
            line.write({"ready": count, "head": ray.get_runtime_context().gcs_address})
            signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))  # Ray's own prints a trace
            pool = ActorPool(ray, task["manifest"], count, task["timeout"])
            after.callback(ray.shutdown)
            after.callback(pool.close)
            for result in pool.run(_rows(line)):
                line.write(asdict(result))
            line.write({"done": True})
        except UniconError as error:
            line.write({"error": str(error)})


if __name__ == "__main__":
    main()
