"""Engines by name, as `unicon sweep --engine` has them, and how each is made."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from unicon_core.errors import UniconError, alternatives
from unicon_ros.sweep.engine import Engine
from unicon_ros.sweep.local import LocalEngine
from unicon_ros.sweep.plan import Plan

__all__ = ["BATCH", "ENGINES", "Wish", "engine_of"]

BATCH = 4
"""Rows that `batch` runs side by side, unless told: eight Go2 do not fit into 1 MB of cache."""


@dataclass(frozen=True)
class Wish:
    """What is asked for.

    Attributes:
        engine: its name.
        workers: processes.
        batch: rows side by side in each process; None where nobody says.

    Raises:
        UniconError: there is no such engine, or it has no batches.
    """

    engine: str = "local"
    workers: int = 1
    batch: int | None = None

    def __post_init__(self) -> None:
        if self.engine not in ENGINES:
            raise UniconError(f"--engine {self.engine}: {alternatives(self.engine, ENGINES)}")
        if self.batch is not None and self.engine != "batch":
            raise UniconError(
                f"--batch {self.batch}: engine {self.engine!r} runs one row at a time in each "
                "process; add --engine batch"
            )


def _local(plan: Plan, wish: Wish, logs: Path) -> Engine:
    return LocalEngine(plan.task(), wish.workers, plan.sweep.timeout, logs)


def _batch(plan: Plan, wish: Wish, logs: Path) -> Engine:
    batch = wish.batch or BATCH
    return LocalEngine(plan.task(), wish.workers, plan.sweep.timeout, logs, batch)


ENGINES: dict[str, Callable[[Plan, Wish, Path], Engine]] = {"local": _local, "batch": _batch}


def engine_of(plan: Plan, wish: Wish, logs: Path) -> Engine:
    """Return an engine that runs rows of a plan.

    Args:
        logs: folder for what its processes print.
    """
    return ENGINES[wish.engine](plan, wish, logs)
