"""An MCAP file that is being written: whole chunks, or nothing, for the recorder.

It grows as `FILE.partial` beside its place and gets its name when it is finished. What stands there
ends with a whole chunk at any time, but for the one that is being written; `recover` finishes it.
"""

from __future__ import annotations

import errno
import fcntl
import os
import zlib
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from unicon_core import __version__
from unicon_lab.recording.records import (
    Channel,
    Chunk,
    chunk_head,
    header,
    index_of,
    message_indexes,
    summary,
)

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""The medium, the user's share of it, or the largest file is used up."""

Buffer: TypeAlias = bytes | bytearray | memoryview


class FileInUse(Exception):
    """Another process writes this file."""


class McapFile:
    """The file. No method is called from two threads at once.

    Args:
        path: of the finished file; its folder exists.

    Attributes:
        path: as given.
        partial: where it grows.
        messages: in whole chunks.
        size: of the whole chunks and what stands before them in [bytes].
        again: messages that were in a file before this one: none.
        schemas, topics, chunks, others: what the summary tells, as of `records.summary`.

    Raises:
        OSError: it cannot be written.
        FileInUse: another process writes it.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.partial = path.with_name(f"{path.name}.partial")
        self.messages = self.size = self.again = 0
        self.schemas: list[bytes] = []
        self.topics: list[bytes] = []
        self.chunks: list[Chunk] = []
        self.others: list[bytes] = []
        # Names are looked up in this folder even if it is moved or its path is taken away.
        self._folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
        self._file = -1
        try:
            flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW
            self._file = os.open(self.partial.name, flags, 0o644, dir_fd=self._folder)
            lock(self._file)
            with suppress(FileNotFoundError):
                there = os.stat(self.partial.name, dir_fd=self._folder)
                if os.path.samestat(there, os.fstat(self._file)):
                    return
            raise FileInUse  # finished and renamed since, or deleted while it was empty
        except BaseException:
            self.leave()
            raise

    @property
    def channels(self) -> int:
        """Number of channels."""
        return len(self.topics)

    def begin(self) -> None:
        """Write the header, over whatever stands there."""
        os.ftruncate(self._file, 0)
        self._append([header(f"unicon_ros {__version__}")])
        with suppress(OSError):  # some file systems do not sync folders
            os.fsync(self._folder)

    def add(self, channel: Channel) -> None:
        """Add a topic."""
        schema, described = channel.schema(), channel.channel()
        self._append([schema, described])
        self.schemas.append(schema)
        self.topics.append(described)

    def add_record(self, written: bytes) -> None:
        """Add an attachment or metadata, as of `records.attachment` and `records.metadata`."""
        entry = index_of(written, self.size)
        self._append([written])
        self.others.append(entry)

    def write(self, records: Buffer, rows: NDArray[np.void]) -> None:
        """Write messages as one chunk; after an error the file ends behind a whole one.

        Where the medium is full they become smaller chunks, as many as there is room for.

        Args:
            records: message records, one after the other.
            rows: where each stands in them, of type `ROW`; at least one.

        Raises:
            OSError: not all of them are written.
        """
        try:
            self._write(records, rows)
        except OSError as error:
            half = len(rows) // 2
            if error.errno not in FULL or not half:
                raise
            middle, rest = int(rows["offset"][half]), rows[half:].copy()
            rest["offset"] -= np.uint64(middle)
            self.write(memoryview(records)[:middle], rows[:half])
            self.write(memoryview(records)[middle:], rest)

    def _write(self, records: Buffer, rows: NDArray[np.void]) -> None:
        times = rows["time"]
        first, last = int(times.min()), int(times.max())
        head = chunk_head(len(records), zlib.crc32(records), first, last)
        indexes, offsets, counts = message_indexes(rows)
        length = len(head) + len(records)
        chunk = Chunk(self.size, length, len(records), first, last, offsets, len(indexes), counts)
        self._append([head, records, indexes])
        self.chunks.append(chunk)
        self.messages += len(rows)

    def sync(self) -> None:
        """Bring it to the medium itself, where a power loss leaves it."""
        os.fdatasync(self._file)

    def gone(self) -> bool:
        """Tell whether somebody deleted the file: what is written has no name any more."""
        return os.fstat(self._file).st_nlink == 0

    def finish(self, path: Path | None = None) -> int:
        """Write the summary, give the file its name, close it; return how many messages it cost.

        Where the medium is full the last chunks make room for the summary.

        Args:
            path: another name in the same folder.

        Raises:
            OSError: there is not even room for the summary, or the name is taken; what is written
                stays in `FILE.partial`, unless no message is left in it.
        """
        before = self.messages
        try:
            while True:
                try:
                    kinds = self.schemas, self.topics, self.chunks, self.others
                    self._append([summary(self.size, *kinds)])
                    os.fsync(self._file)
                    break
                except OSError as error:
                    if error.errno not in FULL or not self.chunks:
                        if not self.messages:  # nobody is helped by it
                            self.discard()
                        raise
                    chunk = self.chunks.pop()
                    self.messages -= sum(chunk.counts.values())
                    self.cut(chunk.start)
            name = (path or self.path).name
            try:
                os.stat(name, dir_fd=self._folder)
            except FileNotFoundError:
                folders = {"src_dir_fd": self._folder, "dst_dir_fd": self._folder}
                os.rename(self.partial.name, name, **folders)
            else:
                reason = "another file took its name meanwhile"
                raise FileExistsError(errno.EEXIST, reason, name)
            with suppress(OSError):
                os.fsync(self._folder)
        finally:
            self.leave()
        return before - self.messages

    def leave(self) -> None:
        """Close it as it is; safe to call twice."""
        file, folder, self._file, self._folder = self._file, self._folder, -1, -1
        for descriptor in (file, folder):
            if descriptor >= 0:
                os.close(descriptor)

    def forget(self) -> int:
        """Close it, where it was deleted; return how many messages are lost with it."""
        lost, self.messages, self.size = self.messages, 0, 0
        self.chunks.clear()
        self.leave()
        return lost

    def counts(self) -> Counter[int]:
        """Return the number of messages by that of their channel."""
        counts: Counter[int] = Counter()
        for chunk in self.chunks:
            counts.update(chunk.counts)
        return counts

    def span(self) -> tuple[int, int] | None:
        """Return first and last time of the messages in [ns], None without any."""
        if not self.chunks:
            return None
        return min(c.first for c in self.chunks), max(c.last for c in self.chunks)

    def discard(self) -> None:
        """Close and delete it."""
        self.size = 0
        try:
            with suppress(OSError):
                os.unlink(self.partial.name, dir_fd=self._folder)
        finally:
            self.leave()

    def read(self, count: int, start: int) -> bytes:
        """Return up to `count` bytes from a place."""
        return os.pread(self._file, count, start)

    def _append(self, parts: list[Buffer]) -> None:
        """Write all of it behind what is whole, or nothing."""
        views = [memoryview(part).cast("B") for part in parts]
        position = self.size
        try:
            while views:
                written = os.pwritev(self._file, views, position)
                position += written
                while views and written >= len(views[0]):
                    written -= len(views.pop(0))
                if views:
                    views[0] = views[0][written:]
        except OSError:
            with suppress(OSError):
                self.cut(self.size)
            raise
        self.size = position

    def cut(self, size: int) -> None:
        """Let the file end behind `size` bytes, which are whole."""
        self.size = size
        os.ftruncate(self._file, size)


def lock(descriptor: int) -> None:
    """Hold a file for this process; the kernel lets go of it even when the process is killed.

    Raises:
        FileInUse: another process holds it.
    """
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise FileInUse from None
    except OSError:  # a file system without locks
        pass
