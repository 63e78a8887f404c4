"""Writers and readers of a segment as processes, for the tests that stop and kill them."""

from __future__ import annotations

import os
import signal
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from unicon_core.states import States, StateSpec
from unicon_core.states.backends.shm import Segment, ShmReader, ShmWatcher, ShmWriter

COUNTED = {"words": StateSpec((256,), "int64")}
"""A value of 2 kB: each word is the number under which it is published."""

PATIENCE = 60.0
"""Longest wait in [s] for something that must come; a busy machine may take its time."""


def start(act: Callable[[], object]) -> int:
    """Run a function in a forked process, which ends without clearing up; return its id."""
    pid = os.fork()
    if pid:
        return pid
    status = 1
    try:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        act()
        status = 0
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(status)


def end(pid: int) -> None:
    """Kill a process that may be stopped, and wait until it has gone."""
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)


@contextmanager
def running(act: Callable[[], object]) -> Iterator[int]:
    """Run a function in a process that is killed in the end."""
    pid = start(act)
    try:
        yield pid
    finally:
        end(pid)


def until(reached: Callable[[], object]) -> None:
    """Wait until something holds."""
    give_up = time.monotonic() + PATIENCE
    while not reached():
        assert time.monotonic() < give_up, "it never came"
        time.sleep(0.0005)


def counted_states() -> States:
    """Return states for `COUNTED`."""
    return States(COUNTED)


def write_counts(name: str, pause: float = 0.0) -> None:
    """Make a segment and publish counts into it for ever."""
    states = counted_states()
    words = states.words
    writer = ShmWriter(Segment.create(name, {"counts": states.layout}), "counts", states)
    number = 0
    while True:
        number += 1
        words[:] = number
        writer.publish()
        if pause:
            time.sleep(pause)


def is_whole(states: States, reader: ShmWatcher) -> bool:
    """Return whether all bytes are those of the number that was read."""
    return bool((states.words == reader.number).all())


def read_counts(name: str, reads: int) -> None:
    """Read the newest value so many times; ends with an error where one is torn, or starves."""
    states = counted_states()
    reader = ShmReader(name, "counts", states)
    until(reader.take)
    words, last, torn = memoryview(states.words), 0, 0
    for _ in range(reads):
        reader._seen = 0  # as if it were new: each look copies, while the writer writes
        if not reader.take():
            continue
        number = reader.number
        assert number >= last, f"{number} after {last}"
        last = number
        if words.tobytes() != number.to_bytes(8, "little") * 256:
            torn += 1
    alive = reader.alive()
    reader.close()
    assert (torn, reader.starved, alive) == (0, 0, True)
