"""Large messages on their way into a recording: copied by one thread, written by another.

Memory is taken once per message that waits at the same time, and used again. A thread that copies
holds Python's lock for some microseconds alone: NumPy copies without it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from unicon_base.arrays import UInt8
from unicon_lab.recording.records import MESSAGE, MESSAGE_HEAD, ROW

MOST_BYTES = 1 << 26
"""Of messages of one topic that wait for the medium: 2.4 s of 640 x 480 colours at 30 Hz."""

SOON_BYTES = 1 << 22
"""With so much they are written at once, and not with the rest after 0.7 s."""

_HEAD = MESSAGE_HEAD.size


class Large:
    """The messages of one topic.

    Args:
        channel: number of the topic's.
        nbytes: of the largest message.
        wake: tells the thread that writes that there is much to do.

    Attributes:
        waiting: records of a message and their rows, as `McapFile.write` takes them; the oldest
            first. The thread that writes calls `free` behind each.
        written: messages that are in the file.
        crowded: messages that had no room here.
        lost: messages that the file did not take.
    """

    def __init__(self, channel: int, nbytes: int, wake: Callable[[], object]) -> None:
        self._channel, self._size, self._wake = channel, _HEAD + nbytes, wake
        self._most = max(MOST_BYTES // self._size, 2)
        self._soon = max(min(SOON_BYTES // self._size, self._most // 2), 1)
        self._spare: deque[UInt8] = deque()
        self._made = 0
        self._used: deque[UInt8] = deque()
        self.waiting: deque[tuple[memoryview, NDArray[np.void]]] = deque()
        self.written = self.crowded = self.lost = 0

    def room(self) -> UInt8 | None:
        """Return where to copy the next message to, shape (nbytes,); None where none is left.

        The same room is given until `put`.
        """
        if not self._spare:
            if self._made == self._most:
                self.crowded += 1
                return None
            self._made += 1
            self._spare.append(np.empty(self._size, np.uint8))
        return self._spare[0][_HEAD:]

    def put(self, length: int, number: int, log_ns: int, stamp_ns: int) -> None:
        """Let the message that lies in the room be written.

        Args:
            length: of the message, [B].
            number: it has it in the file, of 32 bits.
            log_ns: when it was recorded, [ns].
            stamp_ns: when it was true, [ns].
        """
        buffer = self._spare.popleft()
        size, log_ns = _HEAD + length, max(log_ns, 0)  # times in MCAP are unsigned
        head = (size - 9, self._channel, number & 0xFFFFFFFF, log_ns, max(stamp_ns, 0))
        MESSAGE_HEAD.pack_into(buffer.data, 0, MESSAGE, *head)
        self._used.append(buffer)
        row = np.array([(self._channel, log_ns, 0)], ROW)
        self.waiting.append((buffer.data[:size], row))
        if len(self.waiting) >= self._soon:
            self._wake()

    def free(self, written: bool) -> None:
        """Let go of the oldest message, which is in the file or is not."""
        self.waiting.popleft()
        self.written += written
        self.lost += not written
        self._spare.append(self._used.popleft())
