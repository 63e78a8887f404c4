"""Background writing: the tick copies messages into memory, a thread brings them into the file.

The tick never waits for the disk: where four blocks of 2 MiB are full, messages are dropped and
counted. Nothing is done per message in the thread, which would hold the interpreter's lock: a chunk
is one system call on the memory that the tick wrote, and small, so that its index holds that lock
for 0.1 ms at most. Behind each the thread sleeps: a tick that waits for its core goes first. The
threads are of SCHED_BATCH: waking they do not push the tick off its core.
Every 0.7 s what is there goes to the kernel, so that a kill loses no more, and is brought to the
medium at once: a power loss loses up to 1 s, and longer where the medium is slow. More often would
be felt: each time takes 1 ms of a core.

Large messages, such as pictures, come from another thread than the tick's, in memory of their own,
and each is a chunk of its own.
"""

from __future__ import annotations

import os
import struct
import threading
import time
from bisect import bisect_right
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from unicon_base import AnyDict, TextSink
from unicon_lab.recording.mcap_file import McapFile
from unicon_lab.recording.records import MESSAGE, MESSAGE_HEAD, ROW, Buffer, Channel, Large

FLUSH_S = 0.7
SYNC_S = 0.5
"""Between two syncs in [s], where blocks are full earlier."""
CLOSE_S = 5.0
CHUNK_ROWS, CHUNK_BYTES = 1024, 1 << 17
"""Of a chunk at most. Its index is made under Python's lock, for which a tick that wakes has to
wait: 0.1 ms, where one of 35,000 messages (100 topics at 500 Hz for 0.7 s) took 2.7."""
BREATH_S = 0.0002
"""Between two chunks in [s]. Without it 2 MiB are one stretch of 4 ms, by which ticks came late: 3
to 5 a second with 100 topics at 500 Hz."""
BLOCKS, BLOCK_BYTES, BLOCK_ROWS = 4, 1 << 21, 1 << 15

Write: TypeAlias = Callable[[int, Buffer], bool]
"""Takes time in [ns] and bytes of a message; False where it is dropped."""

_ROW = struct.Struct("<HQQ")


class _Block:
    """Memory that the tick appends to and the thread reads.

    Attributes:
        mark: bytes and messages that are complete; set as one, so that they agree.
        taken: those of them that the thread has dealt with.
    """

    def __init__(self, size: int) -> None:
        # Written once, so that no page of it is new to the tick.
        self.data = bytearray(b"\xff") * size
        self.rows = bytearray(b"\xff") * (BLOCK_ROWS * _ROW.size)
        self.mark = self.taken = (0, 0)


class Background:
    """Writes a file from a thread of its own.

    Args:
        file: open and begun; channels are added here.
        path: of the recording, for warnings.
        warn: takes warnings, from the thread.
        patient: where all blocks are full wait for the disk up to 5 s, once: for simulations that
            run as fast as they can.
    """

    def __init__(self, file: McapFile, path: Path, warn: TextSink, patient: bool) -> None:
        self._file, self._warn, self._patient = file, warn, patient
        self._label = f"recording {path}"
        self._block = _Block(BLOCK_BYTES)
        self._queue = deque([self._block])
        self._free = deque(_Block(BLOCK_BYTES) for _ in range(BLOCKS - 1))
        self._others: deque[Callable[[], bytes]] = deque()
        self._large: list[Large] = []
        self._overflow = self._discarded = 0
        self._error = ""
        self._drained = 0
        self._open = True
        self._ending = False
        self._wake, self._flushed, self._ended = (threading.Event() for _ in range(3))
        self._file_in_use = threading.Lock()
        self._threads = [
            threading.Thread(target=work, name=f"recorder {name}", daemon=True)
            for name, work in (("writer", self._work), ("sync", self._sync))
        ]

    def add(self, channel: Channel) -> Write:
        """Add a topic, before `start`, and return what takes its messages: `write(stamp_ns, cdr)`.

        The result is False for a message that is dropped.

        Raises:
            OSError: it cannot be written.
        """
        self._file.add(channel)
        return partial(self._put, channel.number)

    def add_large(self, channel: Channel, nbytes: int) -> Large:
        """Add a topic of large messages, before `start`, and return what takes them.

        Args:
            channel: of the topic.
            nbytes: of the largest message.

        Raises:
            OSError: it cannot be written.
        """
        self._file.add(channel)
        self._large.append(Large(channel.number, nbytes, self._wake.set))
        return self._large[-1]

    def add_record(self, make: Callable[[], bytes]) -> None:
        """Add an attachment or metadata, from the tick too: it is made and written by the thread.

        Args:
            make: returns it as of `records.attachment` and `records.metadata`.
        """
        self._others.append(make)

    def start(self) -> None:
        """Start the threads; safe to call twice."""
        if self._threads[0].ident is None:
            for thread in self._threads:
                thread.start()

    def counts(self) -> AnyDict:
        """Return messages in the file, those dropped, bytes of the file, and the error or ""."""
        messages, size = self._file.recorded
        dropped = self._lost() + self._discarded
        return {"messages": messages, "dropped": dropped, "bytes": size, "error": self._error}

    def flush(self) -> bool:
        """Bring all that was put before onto the medium, from a thread that may wait.

        Returns False where the file has ended: its medium is full or gone.
        """
        until = self._drained + 2  # one of them may have begun before
        while self._drained < until and self._open and not self._ending:
            self._wake.set()
            time.sleep(0.01)
        with self._file_in_use:
            if self._open:
                self._file.sync()
            return self._open

    def _lost(self) -> int:
        """Return the messages that had no room in memory."""
        return self._overflow + sum(large.crowded for large in self._large)

    def close(self) -> None:
        """Write the rest, finish the file; at most 5 s. Never raises, and safe to call twice.

        Where it was not even started the file is deleted.
        """
        self._ending = True
        for event in (self._wake, self._ended, self._flushed):
            event.set()
        writer = self._threads[0]
        if writer.ident is None:
            self._file.discard()
        elif any(thread.is_alive() for thread in self._threads):
            end = time.monotonic() + CLOSE_S
            for thread in self._threads:
                thread.join(max(end - time.monotonic(), 0.0))
            if writer.is_alive():
                self._fail(f"the medium took nothing for {CLOSE_S:g} s")

    # -- the tick's side ------------------------------------------------------------------------

    def _put(self, channel: int, stamp_ns: int, raw: Buffer) -> bool:
        """Take a message; it is copied. False where it is dropped."""
        block = self._block
        begin, count = block.mark
        body = begin + MESSAGE_HEAD.size
        end = body + len(raw)
        if end > len(block.data) or count == BLOCK_ROWS:
            if not self._turn(end - begin):
                self._overflow += 1
                return False
            block = self._block
            begin, count, body, end = 0, 0, MESSAGE_HEAD.size, end - begin
        if stamp_ns < 0:  # times in MCAP are unsigned
            stamp_ns = 0
        data = block.data
        MESSAGE_HEAD.pack_into(
            data, begin, MESSAGE, end - begin - 9, channel, 0, stamp_ns, stamp_ns
        )
        data[body:end] = raw
        _ROW.pack_into(block.rows, count * _ROW.size, channel, stamp_ns, begin)
        block.mark = (end, count + 1)
        return True

    def _turn(self, size: int) -> bool:
        """Go on to a block that is free and has room for a message; False where there is none."""
        if not self._free and self._patient and not self._ending:
            self._wake.set()
            patience = time.monotonic() + CLOSE_S
            while not self._free and self._patient:
                time.sleep(0.001)
                self._patient = time.monotonic() < patience
        try:
            block = self._free.popleft()
        except IndexError:
            return False
        if size > len(block.data):
            block = _Block(size)
        self._queue.append(block)
        self._block = block
        self._wake.set()
        return True

    # -- the threads' side ----------------------------------------------------------------------

    def _work(self) -> None:
        calm()
        lost = 0
        while True:
            self._wake.wait(FLUSH_S)
            self._wake.clear()
            ending = self._ending
            self._drain()
            self._drained += 1
            self._flushed.set()
            if not lost and (lost := self._lost()):
                self._fail(
                    "the medium is too slow; messages are dropped, the report tells how many",
                    over=False,
                )
            if ending:
                break
        with self._file_in_use:
            if self._open and (trouble := self._finish()):
                self._fail(trouble)

    def _drain(self) -> None:
        """Write what the tick and others have completed; blocks that are left become free."""
        while self._others:
            make = self._others.popleft()
            if self._open:
                try:
                    self._file.add_record(make())
                except Exception as error:  # of any kind: the run goes on
                    self._stop(error, 0)
        while True:
            block = self._queue[0]
            left = len(self._queue) > 1  # asked before the mark is read: then the mark is final
            (begin, first), (end, last) = block.taken, block.mark
            while first < last:
                until, upto = end, self._upto(block, begin, first, last)
                if upto < last:
                    until = _offset(block, upto)
                rows = np.frombuffer(block.rows, ROW, upto - first, first * _ROW.size).copy()
                rows["offset"] -= np.uint64(begin)
                self._write(memoryview(block.data)[begin:until], rows)
                block.taken = begin, first = (until, upto)
                if not (self._patient or self._ending):
                    time.sleep(BREATH_S)
            if not left:
                break
            self._queue.popleft()
            if len(block.data) != BLOCK_BYTES:
                block = _Block(BLOCK_BYTES)
            block.mark = block.taken = (0, 0)
            self._free.append(block)
        for large in self._large:
            for _ in range(len(large.waiting)):  # new ones wait: ticks come first
                large.free(self._write(*large.waiting[0]))

    def _upto(self, block: _Block, begin: int, first: int, last: int) -> int:
        """Return behind which message a chunk ends that begins with message `first`."""
        rows = range(first + 1, min(last, first + CHUNK_ROWS))
        key = partial(_offset, block)
        return rows[0] + bisect_right(rows, begin + CHUNK_BYTES, key=key) if rows else last

    def _new(self) -> int:
        """Return how many messages are in the file, each counted once."""
        return self._file.recorded[0] - self._file.again

    def _write(self, records: memoryview, rows: NDArray[np.void]) -> bool:
        """Write messages; return whether they are in the file."""
        if not self._open:
            self._discarded += len(rows)
            return False
        before = self._new()
        try:
            self._file.write(records, rows)
            if self._file.gone():
                self._stop(None, 0)
        except Exception as error:  # of any kind: the run goes on
            self._stop(error, len(rows) - max(self._new() - before, 0))  # some had room
        return self._open

    def _stop(self, error: Exception | None, lost: int) -> None:
        """Finish the file as far as it is whole; what comes after is dropped and counted."""
        with self._file_in_use:
            self._discarded += lost
            trouble = self._finish()
        reason = str(getattr(error, "strerror", None) or error or "")
        told = [reason, trouble or f"the {self._file.recorded[0]} messages before are kept"]
        if reason and trouble.startswith(reason):  # the same error twice
            told = [trouble]
        self._fail(f"{': '.join(filter(None, told))}; the run goes on without it")

    def _finish(self) -> str:
        """Finish the file and return what went wrong, "" where nothing did."""
        self._open, file = False, self._file
        if file.gone():
            self._discarded += file.forget()
            return "somebody deleted it"
        before = file.recorded[0]
        if not before:
            file.discard()
            return self._error or "nothing was recorded"
        try:
            self._discarded += file.finish()
        except OSError as error:
            left = file.recorded[0]
            self._discarded += before - left
            if not left:
                file.discard()
            where = (
                f"; what was recorded is in {file.partial}" if left else ": nothing was recorded"
            )
            return f"{error.strerror}{where}"
        return ""

    def _sync(self) -> None:
        calm()
        while not self._ended.wait(SYNC_S):
            self._flushed.wait()
            self._flushed.clear()
            with self._file_in_use:
                if not self._open:
                    return
                try:
                    self._file.sync()
                except OSError as error:
                    self._fail(f"not on the medium ({error.strerror})", over=False)
                    return

    def _fail(self, reason: str, over: bool = True) -> None:
        if over or not self._error:
            self._error = reason
        with suppress(Exception):  # a terminal that is gone
            self._warn(f"{self._label}: {reason}")


def _offset(block: _Block, row: int) -> int:
    """Return where a message begins in its block."""
    return int(_ROW.unpack_from(block.rows, row * _ROW.size)[2])


def calm() -> None:
    """Let this thread preempt no other when it wakes: sched(7)."""
    with suppress(OSError, AttributeError):  # a sandbox forbids it, or it is not Linux
        if os.sched_getscheduler(0) == os.SCHED_OTHER:
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
