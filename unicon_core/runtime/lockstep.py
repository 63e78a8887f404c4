"""Lockstep: rollouts of several programs in one thread, each tick by tick, for sweeps.

First all robots read, think and command, then the physics of all are simulated. No program knows of
another, so that each does to the bit what it would do alone; but code and network are still in the
cache when the next robot needs them, where the physics of a whole tick would have driven them out.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import Generic, TypeVar

from unicon_core.runtime.rollouts import Rollout, Rollouts

T = TypeVar("T")


class Lockstep(Generic[T]):
    """Rollouts that run side by side.

    They need not begin together, nor be of one workflow.
    """

    def __init__(self) -> None:
        self._running: list[tuple[T, Generator[None, None, Rollout]]] = []

    def __len__(self) -> int:
        return len(self._running)

    def add(self, mark: T, rollouts: Rollouts, limit: int) -> None:
        """Have a rollout run from the next tick on.

        Args:
            mark: that `tick` tells it by.
            rollouts: at their beginning, made with `beside=True`; without it, or where the platform
                cannot wait, the next tick runs all of it.
            limit: most ticks.
        """
        self._running.append((mark, rollouts.halves(limit)))

    def tick(self) -> list[tuple[T, Rollout]]:
        """Run a tick of each rollout; return those that have ended with their marks."""
        ended: list[tuple[T, Rollout]] = []
        for _ in ("commands", "physics"):
            running, self._running = self._running, []
            for one in running:
                try:
                    next(one[1])
                except StopIteration as end:
                    ended.append((one[0], end.value))
                else:
                    self._running.append(one)
        return ended
