"""Records of MCAP as bytes, for those who write and mend files: https://mcap.dev/spec.

Chunks are not compressed: what a killed run has written is then read back by walking along lengths,
and a tick costs no compression.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
