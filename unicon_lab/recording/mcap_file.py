"""An MCAP file that is being written: whole chunks, or nothing, for the recorder.

It grows as `FILE.partial` beside its place and gets its name when it is finished. What stands there
ends with a whole chunk at any time, but for the one that is being written; `recover` finishes it.
"""

from __future__ import annotations

import errno
import fcntl
import os
import struct
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from unicon_core import __version__

MAGIC = b"\x89MCAP0\r\n"

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX = range(9, 14)
SUMMARY_OFFSET, DATA_END = 0x0E, 0x0F

MESSAGE_HEAD = struct.Struct("<BQHIQQ")
"""Opcode, length, channel, sequence, log time and publish time in [ns]; the bytes follow."""

CHUNK_HEAD = struct.Struct("<BQQQQIIQ")
"""Opcode, length, first and last time in [ns], size, CRC, length of the compression's name (0),
size as stored; the records follow."""

ROW = np.dtype([("channel", "<u2"), ("time", "<u8"), ("offset", "<u8")])
"""Where a message stands in the records of its chunk: what message indexes are made of."""


@dataclass(frozen=True)
class Channel:
    """A topic.

    Attributes:
        number: of the channel and of its schema, from 1.
        topic: with a leading slash.
        type: `sensor_msgs/msg/JointState`.
        definition: text of the type with those of its parts.
        encoding: of the text, `ros2msg`.
        rihs: hash of the type, REP-2011.
        qos: of its publisher, see `offered_qos`; "" where nobody published it.
    """

    number: int
    topic: str
    type: str
    definition: str
    encoding: str
    rihs: str
    qos: str = ""

    def schema(self) -> bytes:
        """Return the record of its type."""
        content = _text(self.type) + _text(self.encoding) + _text(self.definition)
        return record(SCHEMA, struct.pack("<H", self.number) + content)

    def channel(self) -> bytes:
        """Return the record of the topic; the type's comes first in the file."""
        metadata = _map({"offered_qos_profiles": self.qos or "[]", "topic_type_hash": self.rihs})
        head = struct.pack("<HH", self.number, self.number)
        return record(CHANNEL, head + _text(self.topic) + _text("cdr") + metadata)


@dataclass(frozen=True)
class Chunk:
    """Where a chunk stands, and what is in it.

    Attributes:
        start, length: of its record in the file.
        size: of the records in it.
        first, last: times of its messages in [ns].
        indexes: channel to where its message index stands, from the end of the chunk's record.
        indexes_length: of all its message indexes.
        counts: channel to number of messages.
    """

    start: int
    length: int
    size: int
    first: int
    last: int
    indexes: Mapping[int, int]
    indexes_length: int
    counts: Mapping[int, int]


def record(opcode: int, content: bytes) -> bytes:
    """Return a record: opcode, length, content."""
    return struct.pack("<BQ", opcode, len(content)) + content


def header(library: str) -> bytes:
    """Return what a file begins with."""
    return MAGIC + record(HEADER, _text("ros2") + _text(library))


def chunk_head(size: int, crc: int, first: int, last: int) -> bytes:
    """Return what stands before the records of a chunk.

    Args:
        size: of the records.
        crc: of the records, CRC-32.
        first, last: times of the messages in [ns].
    """
    return CHUNK_HEAD.pack(CHUNK, CHUNK_HEAD.size - 9 + size, first, last, size, crc, 0, size)


def message_indexes(rows: NDArray[np.void]) -> tuple[bytes, dict[int, int], dict[int, int]]:
    """Return the message indexes of a chunk, where each begins, and the number of messages.

    Args:
        rows: of type `ROW`, one for each message in the order of the chunk; at least one.
    """
    order = np.argsort(rows["channel"], kind="stable")
    entries = np.empty((len(rows), 2), "<u8")
    entries[:, 0], entries[:, 1] = rows["time"][order], rows["offset"][order]
    view, by_channel = memoryview(entries.data).cast("B"), rows["channel"][order]
    begins = [0, *(np.flatnonzero(by_channel[1:] != by_channel[:-1]) + 1).tolist()]
    ends = [*begins[1:], len(rows)]
    parts: list[bytes | memoryview] = []
    offsets: dict[int, int] = {}
    counts: dict[int, int] = {}
    length = 0
    for channel, begin, end in zip(by_channel[begins].tolist(), begins, ends):
        size = 16 * (end - begin)
        head = struct.pack("<BQHI", MESSAGE_INDEX, 6 + size, channel, size)
        parts += (head, view[16 * begin : 16 * end])
        offsets[channel], counts[channel] = length, end - begin
        length += len(head) + size
    return b"".join(parts), offsets, counts


def chunk_index(chunk: Chunk) -> bytes:
    """Return the entry of a chunk in the summary."""
    base = chunk.start + chunk.length
    offsets = b"".join(
        struct.pack("<HQ", channel, base + offset) for channel, offset in chunk.indexes.items()
    )
    content = struct.pack("<QQQQ", chunk.first, chunk.last, chunk.start, chunk.length)
    content += struct.pack("<I", len(offsets)) + offsets
    content += struct.pack("<QIQQ", chunk.indexes_length, 0, chunk.size, chunk.size)
    return record(CHUNK_INDEX, content)


def attachment(name: str, media_type: str, stamp_ns: int, data: bytes) -> bytes:
    """Return the record of a file that goes along, such as a trace."""
    content = struct.pack("<QQ", stamp_ns, stamp_ns) + _text(name) + _text(media_type)
    content += struct.pack("<Q", len(data)) + data
    return record(ATTACHMENT, content + struct.pack("<I", zlib.crc32(content)))


def metadata(name: str, values: Mapping[str, str]) -> bytes:
    """Return the record of facts under a name."""
    return record(METADATA, _text(name) + _map(values))


def index_of(written: bytes, position: int) -> bytes:
    """Return the entry in the summary of an attachment or metadata record.

    Args:
        written: the record.
        position: where it stands in the file.

    Raises:
        struct.error: it is not whole.
    """
    place = struct.pack("<QQ", position, len(written))
    if written[0] == METADATA:
        return record(METADATA_INDEX, place + _texts(written, 9, 1)[0])
    names, after = _texts(written, 25, 2)
    size = struct.pack("<Q", *struct.unpack_from("<Q", written, after))
    return record(ATTACHMENT_INDEX, place + written[9:25] + size + names)


def _texts(raw: bytes, at: int, count: int) -> tuple[bytes, int]:
    """Return texts as they stand in a record, and where they end."""
    begin = at
    for _ in range(count):
        at += 4 + int(struct.unpack_from("<I", raw, at)[0])
    return raw[begin:at], at


def summary(
    start: int,
    schemas: Sequence[bytes],
    channels: Sequence[bytes],
    chunks: Sequence[Chunk],
    others: Sequence[bytes] = (),
) -> bytes:
    """Return all that stands behind the last chunk, the closing magic included.

    Args:
        start: where it will stand in the file.
        schemas, channels: the records of the file.
        chunks: of the file.
        others: entries of attachments and metadata, see `index_of`.
    """
    attachments = [entry for entry in others if entry[0] == ATTACHMENT_INDEX]
    described = [entry for entry in others if entry[0] == METADATA_INDEX]
    counts: Counter[int] = Counter()
    for chunk in chunks:
        counts.update(chunk.counts)
    statistics = struct.pack(
        "<QHIIIIQQI",
        *(counts.total(), len(schemas), len(channels)),
        *(len(attachments), len(described), len(chunks)),
        min((chunk.first for chunk in chunks), default=0),
        max((chunk.last for chunk in chunks), default=0),
        10 * len(counts),
    ) + b"".join(struct.pack("<HQ", *item) for item in sorted(counts.items()))
    parts = [record(DATA_END, bytes(4))]
    offsets: list[bytes] = []
    begin = position = start + len(parts[0])
    for opcode, records in (
        (SCHEMA, schemas),
        (CHANNEL, channels),
        (CHUNK_INDEX, [chunk_index(chunk) for chunk in chunks]),
        (ATTACHMENT_INDEX, attachments),
        (METADATA_INDEX, described),
        (STATISTICS, [record(STATISTICS, statistics)]),
    ):
        group = b"".join(records)
        if group:
            parts.append(group)
            where = struct.pack("<BQQ", opcode, position, len(group))
            offsets.append(record(SUMMARY_OFFSET, where))
            position += len(group)
    footer = record(FOOTER, struct.pack("<QQI", begin, position, 0))
    return b"".join((*parts, *offsets, footer, MAGIC))


def _text(text: str) -> bytes:
    raw = text.encode()
    return struct.pack("<I", len(raw)) + raw


def _map(values: Mapping[str, str]) -> bytes:
    raw = b"".join(_text(key) + _text(value) for key, value in values.items())
    return struct.pack("<I", len(raw)) + raw


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
