"""Handles: large data (images, clouds) beside the states, which hold only their number.

A `FrameRing` is a few frames in memory that processes share. One process fills them; others are
told a handle, an int64 that fits into a state, and look at the frame in place. Nothing is copied
through the state buffer, and who never looks pays nothing.
"""

from __future__ import annotations

import fcntl
import mmap
import os
import stat
import struct
import tempfile
import time
from contextlib import suppress
from pathlib import Path

import numpy as np

from unicon_base.arrays import UInt8

FOLDER = Path("/dev/shm")
_PREFIX = "unicon_frames_"
# int64 in front of the slots' own: latest handle, slots, bytes of a frame, locked, offset, spare
_HEAD = 8
_LOCKED = 1  # its maker holds a lock of flock(2) while it lives
_OFFSET = 4  # from the clock of the stamps to CLOCK_MONOTONIC, [ns]; 0 for a clock of the machine
_SLOT = 2  # int64 for each slot: handle of its frame (0 while it is filled), stamp_ns


class FrameRing:
    """A ring of frames of one size; make it with `create` or `attach`.

    Handles count from 1; 0 is not a frame. A frame is readable until as many newer ones have come
    as the ring has slots, less the one being filled.

    Attributes:
        path: the file behind it, by which another process attaches.
        slots: number of frames.
        nbytes: size of a frame, [B].
    """

    def __init__(self, path: Path, *, lock: int = -1) -> None:
        self.path = path
        self._lock = lock  # a file descriptor; only its maker has it
        with path.open("r+b") as file:
            self._memory = mmap.mmap(file.fileno(), 0)
        memory = self._bytes = memoryview(self._memory)
        self._head = memory[: 8 * _HEAD].cast("q")
        self.slots, self.nbytes = self._head[1], self._head[2]
        frames = self._start = 8 * (_HEAD + _SLOT * self.slots)
        self._table = memory[8 * _HEAD : frames].cast("q")
        self._frames = np.frombuffer(self._memory, np.uint8, offset=frames).reshape(
            self.slots, self.nbytes
        )

    @classmethod
    def create(cls, nbytes: int, slots: int = 4) -> FrameRing:
        """Make a ring in shared memory; its maker removes it with `close`.

        Args:
            nbytes: size of a frame, [B].
            slots: number of frames, at least 2.
        """
        if nbytes < 1 or slots < 2:
            raise ValueError(f"a ring of {slots} frames of {nbytes} B; give >= 2 of >= 1 B")
        lock, name = tempfile.mkstemp(prefix=_PREFIX, dir=FOLDER if FOLDER.is_dir() else None)
        fcntl.flock(lock, fcntl.LOCK_EX)
        head = np.zeros(_HEAD, np.int64)
        head[1:4] = slots, nbytes, _LOCKED
        os.truncate(lock, head.nbytes + 8 * _SLOT * slots + slots * nbytes)
        os.write(lock, head.tobytes())
        return cls(Path(name), lock=lock)

    @classmethod
    def attach(cls, path: str | Path) -> FrameRing:
        """Return the ring that another process made."""
        return cls(Path(path))

    def touch(self, template: bytes = b"\0") -> None:
        """Write to all frames once, so that no page of them is new to who fills them.

        Args:
            template: what a frame holds before it is filled; as long as one, or one byte.
        """
        self._frames[...] = np.frombuffer(template, np.uint8)

    @property
    def latest(self) -> int:
        """Handle of the newest whole frame; 0 if there is none."""
        return self._head[0]

    def fill(self) -> UInt8:
        """Return the slot to write the next frame into, shape (nbytes,); then call `commit`.

        One process fills. The oldest frame is gone from here on.
        """
        slot = (self.latest + 1) % self.slots
        self._table[_SLOT * slot] = 0
        frame: UInt8 = self._frames[slot]
        return frame

    def parts(self) -> tuple[memoryview, memoryview, memoryview, int]:
        """Return what a filler that counts microseconds works on, in the place of `fill`.

        Of frame `handle` the slot is `handle % slots`. Set the slot's first number in the table to
        0, write the frame, set the second to its stamp, then the first and the first one of the
        head to `handle`.

        Returns:
            The head, int64; the table, two int64 a slot; all bytes; where the frames begin in them.
        """
        return self._head, self._table, self._bytes, self._start

    def commit(self, stamp_ns: int) -> int:
        """Make the filled frame the newest; return its handle.

        Args:
            stamp_ns: when its data were true, [ns].
        """
        handle = self.latest + 1
        slot = handle % self.slots
        self._table[_SLOT * slot + 1] = stamp_ns
        self._table[_SLOT * slot] = handle
        self._head[0] = handle
        return handle

    def frame(self, handle: int) -> UInt8 | None:
        """Return a frame in place, shape (nbytes,), read-only; None when it was overwritten.

        Ask `holds` after a long look: the frame may have been overwritten meanwhile.
        """
        if not self.holds(handle):
            return None
        view: UInt8 = self._frames[handle % self.slots].view()
        view.flags.writeable = False
        return view

    def holds(self, handle: int) -> bool:
        """Tell whether a frame is still there."""
        return handle > 0 and self._table[_SLOT * (handle % self.slots)] == handle

    def stamp_ns(self, handle: int) -> int:
        """Return when a frame's data were true in [ns]; 0 when it was overwritten."""
        return self._table[_SLOT * (handle % self.slots) + 1] if self.holds(handle) else 0

    def set_offset(self, offset_ns: int) -> None:
        """Set what brings the stamps of a simulated clock to CLOCK_MONOTONIC, [ns]."""
        self._head[_OFFSET] = offset_ns

    def true_ns(self, handle: int) -> int:
        """Return when a frame's data were true by CLOCK_MONOTONIC, [ns]; see `stamp_ns`."""
        stamp = self.stamp_ns(handle) + self._head[_OFFSET]
        now, wall = time.monotonic_ns(), time.time_ns()
        return stamp if abs(now - stamp) < abs(wall - stamp) else stamp - wall + now

    def close(self) -> None:
        """Let it go; its maker removes it. Views that are still held stay valid."""
        if self._lock >= 0:
            self.path.unlink(missing_ok=True)
            os.close(self._lock)
            self._lock = -1


def clean_frames() -> list[str]:
    """Remove the rings of this user whose maker has died; return the names of their files.

    One that was forked off its maker keeps a ring, and so does a maker that holds no lock.
    """
    removed = []
    for path in sorted(FOLDER.glob(_PREFIX + "*")):
        with suppress(OSError):
            number = os.open(path, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
            try:
                status, head = os.fstat(number), os.pread(number, 8 * 4, 0)
                ours = stat.S_ISREG(status.st_mode) and status.st_uid == os.getuid()
                if ours and len(head) == 8 * 4 and struct.unpack("@4q", head)[3] == _LOCKED:
                    fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)  # fails where it lives
                    path.unlink()
                    removed.append(path.name)
            finally:
                os.close(number)
    return removed
