"""Replays of a motion with many changes of the plant, in processes of their own."""

from __future__ import annotations

import multiprocessing
import signal
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Protocol

import numpy as np

from unicon_base.arrays import Bool, Float64, Int64
from unicon_base.errors import PlatformError, UniconError
from unicon_core.platforms.kit.scene import Scene
from unicon_core.robots import Robot
from unicon_core.signals import SIGNALS
from unicon_lab.diagnose.motion import Motion
from unicon_lab.diagnose.plant import KINDS, Change, Place, Plant, step_of
from unicon_ros.process_exit import die_with_parent

_SHIFTS = np.array([0.05, 0.05, 0.05, 0.002])
"""By which derivatives by the base's velocity and height are taken, in [m/s] and [m]."""
_SHIFT = 0.2
"""The same of a joint's velocity, in [rad/s]."""
_MEASURED = np.array([0.03, 0.03, 0.03, 0.005])
"""Standard deviation of the error of the base's velocity and height. A foot sinks into the ground
of one simulator by some millimetres and not into that of another one."""
_CARRIED = np.array([0.5, 0.5, 0.5, 0.01])
"""The same where its velocity is that by its feet."""
_ROUNDS = 5
_plant: Plant | None = None


def _begin(robot: Robot, scene: Scene, motion: Motion) -> None:
    global _plant
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's, which ends this one
    if sys.platform == "linux" and (parent := multiprocessing.parent_process()) is not None:
        die_with_parent(parent.pid or 0)
    _plant = Plant(robot, scene, motion)


def _work(change: Change, begins: Float64) -> Float64:
    assert _plant is not None
    return _plant.replayed(change, begins)


class Run(Protocol):
    """Replays changes; see `Replays`."""

    def __call__(self, changes: Sequence[Change], begins: Sequence[Float64]) -> list[Float64]: ...

    def clip(self, place: Place, size: float) -> float: ...

    likely: Float64
    step: float


class RunOfAll(Run, Protocol):
    """Replays changes in all windows of a motion."""

    def derived(self, change: Change, begins: Float64) -> tuple[Float64, Float64]: ...

    def settle(self, change: Change) -> Float64: ...

    base: dict[Place, float]
    read_off: dict[Place, int]


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
        read_off: see `Plant`.

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
        self.step, self.read_off = self.plant.step, self.plant.read_off
        of_base = (_CARRIED if motion.sought else _MEASURED)[: 4 * motion.has_base]
        self.likely = np.concatenate([motion.velocity_noise, of_base])
        self._of_joints: Float64 | None = None
        self._progress = progress
        self._motion = motion
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

    def __call__(self, changes: Sequence[Change], begins: Sequence[Float64]) -> list[Float64]:
        """Return what `Plant.replayed` returns for each change.

        Args:
            changes: of the plant.
            begins: of each, as of `Plant.replayed`.

        Raises:
            Interrupted: a signal asked to end; call it within `SIGNALS.guard`.
            UniconError: a process was killed.
        """
        work = list(zip(map(self._whole, changes), begins))
        try:
            return self._answers(work)
        except BrokenProcessPool as error:
            raise UniconError(
                "a process that replays the record was killed; is there memory enough? Try "
                "--processes 1"
            ) from error

    def _answers(self, work: Sequence[tuple[Change, Float64]]) -> list[Float64]:
        found = list[Float64]()
        futures = [self._pool.submit(_work, *each) for each in work] if self._pool else []
        for done, each in enumerate(work):
            SIGNALS.check()
            self._progress(done / len(work))
            while futures and not wait([futures[done]], timeout=0.2).done:
                SIGNALS.check()
            found.append(futures[done].result() if futures else self.plant.replayed(*each))
        return found

    def _whole(self, change: Change) -> Change:
        return {place: self.base.get(place, 0.0) + change.get(place, 0.0)
                for place in {**self.base, **change}}  # fmt: skip

    def clip(self, place: Place, size: float) -> float:
        """Return the size of a change, no less than leaves nothing of what the simulator has."""
        kind, joint = KINDS[place[0]], place[1]
        own = self.plant.own.get(place[0])
        low = (
            kind.low
            if own is None
            else max(kind.low, -float(own[joint] if joint >= 0 else own.max()))
        )
        return float(np.clip(size, low - self.base.get(place, 0.0), kind.high))

    def derived(self, change: Change, begins: Float64) -> tuple[Float64, Float64]:
        """Return the answers with a change, and their derivatives by `begins`, (w, l, m, q).

        Those by the joints' velocities are of the first call.
        """
        n = len(self.plant.limbs)
        shifts = np.concatenate([np.full(n, _SHIFT), _SHIFTS[: 4 * self._motion.has_base]])
        rows = np.diag(shifts)[n * (self._of_joints is not None) :]
        now, *moved = self([change] * (1 + len(rows)), [begins, *(begins + row for row in rows)])
        slopes = (np.stack([now, *moved], axis=-1)[..., 1:] - now[..., None]) / rows.max(axis=1)
        if self._of_joints is None:
            self._of_joints = slopes[..., :n]
        else:
            slopes = np.concatenate([self._of_joints, slopes], axis=-1)
        return now, slopes

    def settle(self, change: Change) -> Float64:
        """Find the base's velocity and height where windows begin, if they were not measured.

        A base whose velocity is wrong drags the feet that stand, so that the joints tell it within
        a window: Gauss and Newton's method, for each window alone, `_ROUNDS` rounds.

        Returns:
            `begins`.
        """
        best = trial = np.zeros((len(self._motion.starts), len(self.likely)))
        if not self._motion.sought:
            return best
        real, likely = self._motion.answers, self.likely
        cost, part = np.full(len(best), np.inf), np.ones(len(best))
        step, scale = np.zeros_like(best), None
        for _ in range(_ROUNDS):
            now, slopes = self.derived(change, trial)
            left = real - now
            if scale is None:
                scale = 1.5 * np.median(np.abs(left), axis=(0, 1)) + 1e-6
            size = np.minimum((left / scale) ** 2, 9.0).sum(axis=(1, 2))
            size += ((trial / likely) ** 2).sum(axis=1)
            better = size < cost
            best = np.where(better[:, None], trial, best)
            cost = np.minimum(size, cost)
            part = np.where(better, 1.0, 0.3 * part)
            weighted = slopes / scale[:, None] ** 2
            curvature = np.einsum("wlmp,wlmq->wpq", weighted, slopes) + np.diag(likely**-2.0)
            asked = np.einsum("wlmp,wlm->wp", weighted[better], left[better])
            asked -= trial[better] / likely**2
            step[better] = np.linalg.solve(curvature[better], asked[..., None])[..., 0]
            trial = best + part[:, None] * step
        return best

    def __enter__(self) -> Replays:
        return self

    def __exit__(self, *_: object) -> None:
        self.plant.close()
        if self._pool is not None:
            for each in {*multiprocessing.active_children()} - self._others:
                each.kill()  # one that was stopped would be waited for without end
            self._pool.shutdown(cancel_futures=True)


class Part:
    """Replays of some windows alone; see `Run`.

    Args:
        run: replays all.
        chosen: whether a window is one of them, shape (w,).
    """

    def __init__(self, run: Run, chosen: Bool) -> None:
        self._run, self._chosen = run, chosen
        self.clip, self.likely, self.step = run.clip, run.likely, run.step

    def __call__(self, changes: Sequence[Change], begins: Sequence[Float64]) -> list[Float64]:
        whole = [np.full((len(self._chosen), each.shape[1]), np.nan) for each in begins]
        for each, some in zip(whole, begins):
            each[self._chosen] = some
        return [answers[self._chosen] for answers in self._run(changes, whole)]


class Aside:
    """Replays in which changes that can be read off show in their channels alone; see `Run`.

    A window that begins with another turn rate goes on with other contacts, and that hides them.

    Args:
        run: replays all windows.
        known: change that is replayed as it is.
    """

    def __init__(self, run: RunOfAll, known: Change) -> None:
        self._run, self._known = run, known
        self.clip, self.likely, self.step = run.clip, run.likely, run.step

    def __call__(self, changes: Sequence[Change], begins: Sequence[Float64]) -> list[Float64]:
        channels, known = self._run.read_off, self._known
        aside = [[place for place in change if place in channels] for change in changes]
        plain = [
            {**change, **{place: known.get(place, 0.0) for place in its}}
            for change, its in zip(changes, aside)
        ]
        found = self._run(plain, begins)
        for change, its, answers in zip(changes, aside, found):
            for place in its:
                answers[..., channels[place]] += change[place] - known.get(place, 0.0)
        return found


def derivatives(
    places: Sequence[Place], limbs: Int64, run: Run, begins: Float64, now: Float64
) -> dict[Place, list[Float64]]:
    """Return derivatives of windows' answers by places of a plant, shape (w, l, m) each.

    The first of a place is that by `step_of`, others are differences over `Kind.far` both ways.

    Args:
        places: by which.
        limbs: of each joint, shape (n,); joints of several limbs are moved at once, each its own.
        run: replays windows.
        begins: of these, as of `Plant.replayed`.
        now: their answers without a change.
    """
    found: dict[Place, list[Float64]] = {}
    together: dict[tuple[str, int], list[Place]] = {}
    for kind, joint in places:
        turn = joint if joint < 0 else int((limbs[:joint] == limbs[joint]).sum())
        together.setdefault((kind, turn), []).append((kind, joint))
    steps = [step_of(group[0]) for group in together.values()]
    changes = [dict.fromkeys(group, step) for group, step in zip(together.values(), steps)]
    moved = run(changes, [begins] * len(changes))
    for group, each, step in zip(together.values(), moved, steps):
        for place in group:
            own = np.ones(now.shape[-1], np.bool_)
            if len(group) > 1:
                own[len(limbs) :] = False
                own[: len(limbs)] = limbs == limbs[place[1]]
            found[place] = [(each - now) / step * own]
    far = [(p, sign * size) for p in places if (size := KINDS[p[0]].far) for sign in (1.0, -1.0)]
    moved = run([{place: size} for place, size in far], [begins] * len(far))
    for (place, size), each in zip(far, moved):
        found[place].append((each - now) / size)
    return found
