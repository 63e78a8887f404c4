"""The robots of a batch, stepped by several threads: MuJoCo simulates without Python's lock."""

from __future__ import annotations

import os
import weakref
from collections.abc import Callable, Sequence
from functools import partial
from queue import SimpleQueue
from threading import Thread

import numpy as np

from unicon_base.arrays import Array
from unicon_core.platforms.kit.command import Command
from unicon_core.platforms.mujoco.servo import Servo, Told
from unicon_core.platforms.mujoco.simulated_robot import SimulatedRobot

Part = tuple[int, list[Told]]
"""Physics steps, and what acts in them on each robot."""

FEWEST = 2
"""Robots for which a thread is worth its while."""


def shares(count: int) -> list[range]:
    """Return the robots of each thread: at most one thread for each core that we may use."""
    affinity = getattr(os, "sched_getaffinity", None)  # of Linux
    cores = len(affinity(0)) if affinity else os.cpu_count() or 1
    threads = max(min(cores, count // FEWEST), 1)
    return [range(i * count // threads, (i + 1) * count // threads) for i in range(threads)]


Job = Callable[[], object]
Ended = SimpleQueue[tuple[int, BaseException | None]]
Inbox = SimpleQueue["Ended | None"]


class SideBySide:
    """Does all jobs at each call: the first one in the caller's thread.

    A signal handler may close it in the middle of a call, hence `SimpleQueue`: it is the one queue
    that may be entered twice.

    Args:
        jobs: one or more; with one there are no threads.
        name: of the threads.
    """

    def __init__(self, jobs: Sequence[Job], name: str) -> None:
        self._jobs = tuple(jobs)
        self._inboxes = [Inbox() for _ in jobs[1:]]
        self._threads = [
            Thread(target=_serve, args=(rank, job, inbox), name=f"{name} {rank}", daemon=True)
            for rank, (job, inbox) in enumerate(zip(jobs[1:], self._inboxes), 1)
        ]
        # Also where nobody closes it.
        self._end = weakref.finalize(self, _end, self._inboxes)
        # Not at the first call: a thread is born with the priority and the core of its parent.
        for thread in self._threads:
            thread.start()

    def __call__(self) -> None:
        """Do all jobs; once closed, one after the other.

        Raises:
            BaseException: what a job raised, once all have ended; of several the first job's.
        """
        first, *others = self._jobs
        if not self._end.alive:
            for job in self._jobs:
                job()
            return
        ended = Ended()  # of this call: what an interrupted one left is not taken for it
        for inbox in self._inboxes:
            inbox.put(ended)
        try:
            first()
        finally:
            errors = dict(ended.get() for _ in others)
        for rank in sorted(errors):
            if (error := errors[rank]) is not None:
                raise error

    def close(self) -> None:
        """End the threads, what they do being done; safe to call twice."""
        self._end()
        for thread in self._threads:
            thread.join()


def _serve(rank: int, job: Job, inbox: Inbox) -> None:
    while (ended := inbox.get()) is not None:
        error: BaseException | None = None
        try:
            job()
        except BaseException as raised:
            error = raised
        ended.put((rank, error))
        del ended, error


def _end(inboxes: Sequence[Inbox]) -> None:
    for inbox in inboxes:
        inbox.put(None)


class Batch:
    """Simulates a tick of every robot.

    The robots of a thread share a model, into which each one's gains are written before its step.
    No robot depends on another, so that neither their number nor the threads' changes a bit.

    Args:
        command: of all robots.
        robots: in order of their rank.
        decimation: physics steps in a tick.
        shares: ranks of the robots of each thread.
        servos: of each thread.
    """

    def __init__(
        self,
        command: Command,
        robots: Sequence[SimulatedRobot],
        decimation: int,
        shares: Sequence[range],
        servos: Sequence[Servo],
    ) -> None:
        self._take = command.take
        self._rows = command.rows
        self._robots = robots
        self._decimation = decimation
        self._parts: list[Part] = []
        self._told = servos[0].told
        jobs = [
            partial(_simulate, servo, robots, share, self._parts)
            for servo, share in zip(servos, shares, strict=True)
        ]
        self._step = SideBySide(jobs, "mujoco")
        self.close = self._step.close

    def __call__(self) -> None:
        """Take all commands and simulate one tick.

        Raises:
            Fault: a command is not finite, or the physics of a robot blew up: of several the first.
        """
        self._take()
        # Reckoned for all at once, here: threads that hold Python's lock wait for each other.
        self._parts[:] = [(steps, self._told(command)) for steps, command in self._commands()]
        self._step()

    def _commands(self) -> list[tuple[int, Array]]:
        """Return physics steps, and the commands that act in them, shape (5, N, n)."""
        delays = [robot.delay() for robot in self._robots if robot.delay is not None]
        if not delays:
            return [(self._decimation, self._rows)]
        return [
            (each[0][0], np.stack([command for _, command in each], axis=1))
            for each in zip(*delays, strict=True)
        ]


def _simulate(
    servo: Servo, robots: Sequence[SimulatedRobot], ranks: range, parts: list[Part]
) -> None:
    for rank in ranks:
        robot = robots[rank]
        own = [(steps, told[rank]) for steps, told in parts]
        robot.tell_again = partial(servo.write, robot.data.ctrl, own[-1][1])
        robot.simulate(servo.write, own)
