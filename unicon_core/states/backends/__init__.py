"""Backends: groups of states carried to other processes and machines, behind one contract.

    shm    shared memory of one machine: a ring of four slots in /dev/shm
    zmq    a message queue between processes or machines: docs/howto/zmq.md

Control runs on local memory whatever the backend is. A *group* is some states that one process
writes: its bytes are those of the group's own `Layout`, the same on each backend. A `Writer`
publishes the group's present values, a `Reader` takes the newest whole one; blocks read and write
states and know neither.
"""

from __future__ import annotations

from typing import Protocol

__all__ = ["Reader", "Writer"]


class Writer(Protocol):
    """Publishes one group; nobody who reads it can make it wait."""

    def publish(self) -> None:
        """Publish the group's values as they are now."""
        ...

    def close(self) -> None:
        """Let go; readers learn that the writer has gone."""
        ...


class Reader(Protocol):
    """Takes one group's newest value, whole or not at all.

    Attributes:
        number: of the value that was taken last, counted by its writer from 1; 0: none yet.
        stamp_ns: when that value was published, on this machine's `time.monotonic_ns`.
        skipped: values between those taken, which nobody looked at.
    """

    number: int
    stamp_ns: int
    skipped: int

    def take(self) -> bool:
        """Copy the newest value into the states; False where it has been taken before."""
        ...

    def restore(self) -> None:
        """Copy the value that was taken last into the states once more, if there was one."""
        ...

    def wait(self, timeout: float) -> bool:
        """Return True when a value is there that has not been taken, False after `timeout` [s]."""
        ...

    def alive(self) -> bool:
        """Return whether the writer lives, as far as can be seen; may follow a new writer."""
        ...

    def close(self) -> None:
        """Let go."""
        ...
