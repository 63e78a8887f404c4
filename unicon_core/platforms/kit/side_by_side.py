"""Jobs that are done again and again, each by a thread of its own, for platforms."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Sequence
from queue import SimpleQueue
from threading import Thread

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
        self._jobs, self._inboxes = tuple(jobs), [Inbox() for _ in jobs[1:]]
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
