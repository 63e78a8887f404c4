"""Shared memory: groups of states that other processes of this machine read, each value whole.

    segment = Segment.create("walk", {"measured": group})
    writer = ShmWriter(segment, "measured", states)
    writer.publish()                                    # about a microsecond, nobody can delay it

    reader = ShmReader("walk", "measured", states)      # in another process
    if reader.wait(0.02): reader.take()

A segment is one file, `/dev/shm/unicon-<uid>-<name>`, of mode 0600. Each group is a ring of four
slots: a writer fills the oldest and then makes it the latest, so that a reader has three publishing
periods to copy a value, and sees by the slot's number whether it was overwritten meanwhile. Nobody
waits on a lock, and a writer that is killed at any moment leaves the value before whole. The place
of everything is told in docs/reference/states.md and written as C by `unicon states --header`.

The locks that there are tell who lives, and the kernel lets them go with their process: byte 0 of
the file is locked by the writer, one byte for each reader that sleeps (F_OFD_SETLK in fcntl(2)).
Python's own `multiprocessing.shared_memory` is not used: its tracker removes a segment when a
process that only reads it ends.

A process that forks keeps its segments for itself: the child lets go of what the parent writes, so
that the lock tells of the parent alone. It must neither publish nor read with what its parent made.
"""

from unicon_core.states.backends.shm.files import (
    clean,
    remove_dead,
    segment_path,
    segments,
)
from unicon_core.states.backends.shm.ring import ShmReader, ShmWatcher, ShmWriter
from unicon_core.states.backends.shm.segment import Segment, places

__all__ = [
    "Segment",
    "ShmReader",
    "ShmWatcher",
    "ShmWriter",
    "clean",
    "places",
    "remove_dead",
    "segment_path",
    "segments",
]
