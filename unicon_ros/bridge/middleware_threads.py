"""Middleware threads: keeps the threads of DDS from pushing the tick's thread off its core.

A write wakes two or three threads of the middleware, each of which preempts the writer: with a
reader that hangs, `publish` took 84 µs at p50 and 1440 at p99 on a busy machine, with 1.7 forced
switches a call. Threads of SCHED_BATCH do not preempt on waking (sched(7)): then 63 and 158 µs and
none, while they still run at once on a free core. It needs no privilege and is not a priority.
"""

from __future__ import annotations

import contextlib
import os
import threading


def calm_middleware_threads() -> int:
    """Give this process's threads that are not Python's SCHED_BATCH; return how many there were.

    Does nothing where the system has no such thing, or where a thread has a policy of its own.
    """
    if not hasattr(os, "SCHED_BATCH"):
        return 0
    own = {thread.native_id for thread in threading.enumerate()} | {threading.get_native_id()}
    calmed = 0
    try:
        numbers = [int(name) for name in os.listdir("/proc/self/task")]
    except OSError:
        return 0
    for number in numbers:
        if number in own:
            continue
        with contextlib.suppress(OSError):  # it has ended, or a sandbox forbids it
            if os.sched_getscheduler(number) == os.SCHED_OTHER:
                os.sched_setscheduler(number, os.SCHED_BATCH, os.sched_param(0))
                calmed += 1
    return calmed
