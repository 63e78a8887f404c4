"""Engines by name, as `unicon sweep --engine` has them, and how each is made."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from unicon_core.errors import UniconError, alternatives
from unicon_ros.sweep.engine import Engine
from unicon_ros.sweep.local import LocalEngine
from unicon_ros.sweep.on_ray.engine import RayEngine, require_ray
from unicon_ros.sweep.plan import Plan
from unicon_ros.sweep.sweep_file import SweepFile

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
