"""An MCAP file that is being written: whole chunks, or nothing, for the recorder.

It grows as `FILE.partial` beside its place and gets its name when it is finished. `FILE.partial`
ends with a whole chunk at any time, except for the one being written; `recover` finishes it.
"""

from __future__ import annotations

import errno
import fcntl
import mmap
import os
import struct
import zlib
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from unicon_base import UniconError
from unicon_core import __version__
from unicon_lab.recording.records import (
    ATTACHMENT_INDEX,
    CHANNEL,
    CHUNK,
    CHUNK_HEAD,
    CHUNK_INDEX,
    DATA_END,
    FOOTER,
    HEADER,
    MAGIC,
    METADATA_INDEX,
    SCHEMA,
    STATISTICS,
    SUMMARY_OFFSET,
    Buffer,
    Channel,
    Chunk,
    index_of,
    indexed,
    packed_text,
    record,
    totals,
)

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""The medium, the user's share of it, or the largest file is used up."""


class FileInUse(UniconError):
    """Another process writes this file."""

    def __init__(self, path: Path) -> None:
        super().__init__(
            f"recording {path} is being written by another run; let that end first, or give "
            "another name"
        )


class McapFile:
    """The file. No method is called from two threads at once.

    Args:
        path: of the finished file; its folder exists.

    Attributes:
        path: as given.
        partial: where it grows.
        messages: in whole chunks.
        size: of the whole chunks and of the records before them in [bytes].
        again: of the messages those that files begin with anew.
        schemas, topics, chunks, others: for the summary; others are made by `index_of`.

    Raises:
        OSError: it cannot be written.
        FileInUse: another process writes it.
    """

    again = 0
    _before = (0, 0)

    def __init__(self, path: Path) -> None:
        self.path = path
        self.partial = path.with_name(f"{path.name}.partial")
        self.messages = self.size = 0
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
            lock(self._file, path)
            with suppress(FileNotFoundError):
                there = os.stat(self.partial.name, dir_fd=self._folder)
                if os.path.samestat(there, os.fstat(self._file)):
                    return
            raise FileInUse(path)  # finished and renamed since, or deleted while it was empty
        except BaseException:
            self.leave()
            raise

    @property
    def recorded(self) -> tuple[int, int]:
        """Messages and bytes of this file and of those that it follows."""
        return self._before[0] + self.messages, self._before[1] + self.size

    def begin(self) -> None:
        """Write the header, over anything that stands there."""
        os.ftruncate(self._file, 0)
        library = packed_text("ros2") + packed_text(f"unicon_ros {__version__}")
        self._append([MAGIC, record(HEADER, library)])
        with suppress(OSError):  # some file systems do not sync folders
            os.fsync(self._folder)

    def add(self, channel: Channel) -> None:
        """Add a topic."""
        schema, described = channel.records()
        self._append([schema, described])
        self.schemas.append(schema)
        self.topics.append(described)

    def add_record(self, written: bytes) -> None:
        """Add an attachment or metadata, as of `attachment` and `metadata`."""
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
        size = len(records)
        indexes, chunk = indexed(rows, self.size, size)
        times, crc = (chunk.first, chunk.last), zlib.crc32(records)
        head = CHUNK_HEAD.pack(CHUNK, CHUNK_HEAD.size - 9 + size, *times, size, crc, 0, size)
        try:
            self._append([head, records, indexes])
        except OSError as error:
            half = len(rows) // 2
            if error.errno not in FULL or not half:
                raise
            middle, rest = int(rows["offset"][half]), rows[half:].copy()
            rest["offset"] -= np.uint64(middle)
            McapFile.write(self, memoryview(records)[:middle], rows[:half])
            McapFile.write(self, memoryview(records)[middle:], rest)
            return
        self.chunks.append(chunk)
        self.messages += len(rows)

    def sync(self) -> None:
        """Bring it to the medium itself, where a power loss leaves it; from another thread too."""
        file = self._file
        try:
            os.fdatasync(file)
        except OSError:
            if self._file == file >= 0:  # else it has just been finished, which syncs it
                raise

    def gone(self) -> bool:
        """Return whether somebody deleted the file: it has no name any more."""
        return self._file >= 0 and os.fstat(self._file).st_nlink == 0

    def finish(self, path: Path | None = None) -> int:
        """Write the summary, give the file its name, close it; return how many messages it cost.

        Where the medium is full the last chunks make room for the summary.

        Args:
            path: another name in the same folder.

        Raises:
            OSError: there is not even room for the summary, or the name is taken; the messages
                stay in `FILE.partial`, unless none is left.
        """
        before = self.messages
        try:
            while True:
                try:
                    self._append([self._summary()])
                    os.fsync(self._file)
                    break
                except OSError as error:
                    if error.errno not in FULL or not self.chunks:
                        if not self.messages:
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
                raise FileExistsError(errno.EEXIST, "another file took its name meanwhile", name)
            with suppress(OSError):
                os.fsync(self._folder)
        finally:
            self.leave()
        return before - self.messages

    def _summary(self) -> bytes:
        """Return all that stands behind the last chunk, the closing magic included."""
        groups = {
            SCHEMA: self.schemas,
            CHANNEL: self.topics,
            CHUNK_INDEX: [chunk.entry for chunk in self.chunks],
            **{
                opcode: [entry for entry in self.others if entry[0] == opcode]
                for opcode in (ATTACHMENT_INDEX, METADATA_INDEX)
            },
        }
        counts, span = totals(self.chunks)
        # The order of the statistics' counts is that of MCAP.
        order = (SCHEMA, CHANNEL, ATTACHMENT_INDEX, METADATA_INDEX, CHUNK_INDEX)
        lengths = [len(groups[opcode]) for opcode in order]
        numbers = counts.total(), *lengths, *(span or (0, 0)), 10 * len(counts)
        statistics = struct.pack("<QHIIIIQQI", *numbers)
        statistics += b"".join(struct.pack("<HQ", *item) for item in sorted(counts.items()))
        groups[STATISTICS] = [record(STATISTICS, statistics)]
        end = record(DATA_END, bytes(4))
        begin, summary, offsets = self.size + len(end), b"", b""
        for opcode, records in groups.items():
            if records:
                group = b"".join(records)
                place = struct.pack("<BQQ", opcode, begin + len(summary), len(group))
                offsets += record(SUMMARY_OFFSET, place)
                summary += group
        footer = record(FOOTER, struct.pack("<QQI", begin, begin + len(summary), 0))
        return end + summary + offsets + footer + MAGIC

    def leave(self) -> None:
        """Close it as it is; safe to call twice."""
        for descriptor in (self._file, self._folder):
            if descriptor >= 0:
                os.close(descriptor)
        self._file = self._folder = -1

    def forget(self) -> int:
        """Close it, where it was deleted; return how many messages are lost with it."""
        lost, self.messages, self.size = self.messages, 0, 0
        self.chunks.clear()
        self.leave()
        return lost

    def discard(self) -> None:
        """Close and delete it."""
        self.size = 0
        with suppress(OSError):
            os.unlink(self.partial.name, dir_fd=self._folder)
        self.leave()

    def content(self) -> memoryview:
        """Return what stands in it, mapped, shape (bytes,); of an empty file nothing."""
        size = os.fstat(self._file).st_size
        return memoryview(mmap.mmap(self._file, 0, access=mmap.ACCESS_READ) if size else b"")

    def _append(self, parts: list[Buffer]) -> None:
        """Write all of it behind the last whole chunk, or nothing."""
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


def lock(descriptor: int, path: Path) -> None:
    """Hold a file for this process; the kernel lets go of it even when the process is killed.

    Raises:
        FileInUse: another process holds it.
    """
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise FileInUse(path) from None
    except OSError:  # a file system without locks
        pass
