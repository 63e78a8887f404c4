"""Replays of a motion with many changes of the plant, in processes of their own."""

from __future__ import annotations

import multiprocessing
import signal
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool

import numpy as np

from unicon_base.arrays import Float64
from unicon_base.errors import PlatformError, UniconError
from unicon_core.platforms.kit.scene import Scene
from unicon_core.robots import Robot
from unicon_core.signals import SIGNALS
from unicon_lab.diagnose.motion import Motion
from unicon_lab.diagnose.plant import Change, Place, Plant
from unicon_ros.process_exit import die_with_parent

_SHIFTS = np.array([0.05, 0.05, 0.05, 0.002])
"""By which derivatives by `begins` are taken, in [m/s] and [m]."""
_LIKELY = np.array([0.5, 0.5, 0.5, 0.005])
"""Standard deviation of `begins` around the guess."""
_ROUNDS = 5

_plant: Plant | None = None


def _begin(robot: Robot, scene: Scene, motion: Motion) -> None:
    global _plant
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's, which ends this one
    if sys.platform == "linux" and (parent := multiprocessing.parent_process()) is not None:
        die_with_parent(parent.pid or 0)
    _plant = Plant(robot, scene, motion)


def _work(change: Change, begins: Float64 | None) -> Float64:
    assert _plant is not None
    return _plant.replayed(change, begins)


class Replays:
    """Replays with many changes; a context, which ends its processes.

    Args:
        robot: that is simulated.
        scene: its model and joints.
        motion: that is replayed.
        processes: at once; 1 stays in this one.
        progress: takes the share of the replays of a call that is done.

    Attributes:
        step: of the simulator in [s].
        base: change that each replay has besides its own.
        begins: as of `Plant.replayed`, as `settle` found them; None before.

    Raises:
        PlatformError: the simulator cannot be built.
    """

    def __init__(
        self,
        robot: Robot,
        scene: Scene,
        motion: Motion,
        processes: int,
        progress: Callable[[float], object] = bool,
    ) -> None:
        self.plant = Plant(robot, scene, motion)
        self.base: dict[Place, float] = {}
        self.step = self.plant.step
        self._progress = progress
        self._motion = motion
        self.begins: Float64 | None = None
        if motion.has_base and self.plant.base is None:
            raise PlatformError(
                f"{robot.name}: the record has a base that moves and the model has none; give "
                "the model of the free robot"
            )
        self._pool: ProcessPoolExecutor | None = None
        self._others = {*multiprocessing.active_children()}
        if processes > 1:
            # Not forked: this process may have threads, of ROS or of a network's runtime.
            context = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(processes, context, _begin, (robot, scene, motion))

    def __call__(
        self, changes: Sequence[Change], begins: Sequence[Float64 | None] | None = None
    ) -> list[Float64]:
        """Return what `Plant.replayed` returns for each change.

        Args:
            changes: of the plant.
            begins: of each, instead of those that `settle` found.

        Raises:
            Interrupted: a signal asked to end; call it within `SIGNALS.guard`.
            UniconError: a process was killed.
        """
        found = list[Float64]()
        work = list(zip(map(self._whole, changes), begins or [self.begins] * len(changes)))
        futures = [self._pool.submit(_work, *each) for each in work] if self._pool else []
        for done, each in enumerate(work):
            SIGNALS.check()
            self._progress(done / len(work))
            while futures and not wait([futures[done]], timeout=0.2).done:
                SIGNALS.check()
            try:
                found.append(futures[done].result() if futures else self.plant.replayed(*each))
            except BrokenProcessPool as error:
                raise UniconError(
                    "a process that replays the record was killed; is there memory enough? Try "
                    "--processes 1"
                ) from error
        return found

    def _whole(self, change: Change) -> Change:
        return {place: self.base.get(place, 0.0) + change.get(place, 0.0)
                for place in {**self.base, **change}}  # fmt: skip

    def settle(self, change: Change) -> Float64 | None:
        """Find the base's velocity and height where windows begin, if they were not measured.

        A base whose velocity is wrong drags the feet that stand, so that the joints tell it within
        a window: Gauss and Newton's method, for each window alone, up to `_ROUNDS` rounds.

        Returns:
            Derivatives of the answers by them, shape (w, l, m, 4); None where they were measured.
        """
        if not self._motion.sought:
            return None
        real = self._motion.answers
        guess = self.plant.carried()
        best = guess if self.begins is None else self.begins
        cost, part = np.full(len(best), np.inf), np.ones(len(best))
        trial, slopes, step = best, np.zeros((*real.shape, 4)), np.zeros_like(best)
        scale = None
        for _ in range(_ROUNDS if self.begins is None else 2):
            beside = [trial, *(trial + row for row in np.diag(_SHIFTS))]
            now, *moved = self([change] * 5, beside)
            left = real - now
            if scale is None:
                scale = 1.5 * np.median(np.abs(left), axis=(0, 1)) + 1e-6
            size = np.minimum((left / scale) ** 2, 9.0).sum(axis=(1, 2))
            size += (((trial - guess) / _LIKELY) ** 2).sum(axis=1)
            better = size < cost
            here = np.stack(moved, axis=-1) - now[..., None]
            slopes[better] = here[better] / _SHIFTS
            best = np.where(better[:, None], trial, best)
            cost = np.minimum(size, cost)
            part = np.where(better, 1.0, 0.3 * part)
            weighted = slopes / scale[:, None] ** 2
            curvature = np.einsum("wlmp,wlmq->wpq", weighted, slopes) + np.diag(_LIKELY**-2.0)
            asked = np.einsum("wlmp,wlm->wp", weighted[better], left[better])
            asked += (guess - trial)[better] / _LIKELY**2
            step[better] = np.linalg.solve(curvature[better], asked[..., None])[..., 0]
            trial = best + part[:, None] * step
        self.begins = best
        return slopes

    def __enter__(self) -> Replays:
        return self

    def __exit__(self, *_: object) -> None:
        self.plant.close()
        if self._pool is not None:
            for each in {*multiprocessing.active_children()} - self._others:
                each.kill()  # one that was stopped would be waited for without end
            self._pool.shutdown(cancel_futures=True)
