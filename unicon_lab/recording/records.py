"""Records of MCAP as bytes, for the modules that write, read and mend files: https://mcap.dev/spec.

Chunks are not compressed: recovery walks along the lengths of records, and a tick costs no
compression.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from unicon_base.arrays import UInt8

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
"""Where a message stands in the records of its chunk: message indexes are made of it."""

_PLACE = np.dtype([("channel", "<u2"), ("offset", "<u8")])

Buffer: TypeAlias = bytes | bytearray | memoryview


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

    def records(self) -> tuple[bytes, bytes]:
        """Return the record of the type, and that of the topic."""
        number = struct.pack("<H", self.number)
        schema = packed_text(self.type) + packed_text(self.encoding) + packed_text(self.definition)
        facts = _map({"offered_qos_profiles": self.qos or "[]", "topic_type_hash": self.rihs})
        channel = 2 * number + packed_text(self.topic) + packed_text("cdr") + facts
        return record(SCHEMA, number + schema), record(CHANNEL, channel)


@dataclass(frozen=True)
class Chunk:
    """A chunk in its file.

    Attributes:
        start: of its record in the file.
        first, last: times of its messages in [ns].
        counts: channel to number of messages.
        entry: its record in the summary.
    """

    start: int
    first: int
    last: int
    counts: Mapping[int, int]
    entry: bytes


def record(opcode: int, content: bytes) -> bytes:
    """Return a record: opcode, length, content."""
    return struct.pack("<BQ", opcode, len(content)) + content


def indexed(rows: NDArray[np.void], start: int, size: int) -> tuple[bytes, Chunk]:
    """Return the message indexes of a chunk, and the chunk.

    Args:
        rows: of type `ROW`, one for each message in the order of the chunk; at least one.
        start: of the chunk's record in the file.
        size: of the records in the chunk.
    """
    order = np.argsort(rows["channel"], kind="stable")
    entries = np.empty((len(rows), 2), "<u8")
    entries[:, 0], entries[:, 1] = rows["time"][order], rows["offset"][order]
    view, by_channel = memoryview(entries.data).cast("B"), rows["channel"][order]
    begins = np.append(0, np.flatnonzero(by_channel[1:] != by_channel[:-1]) + 1)
    sizes = 16 * np.diff(begins, append=len(rows))
    channels, length = by_channel[begins], CHUNK_HEAD.size + size
    parts: list[Buffer] = []
    for channel, begin, there in zip(channels.tolist(), begins.tolist(), sizes.tolist()):
        head = struct.pack("<BQHI", MESSAGE_INDEX, 6 + there, channel, there)
        parts += (head, view[16 * begin : 16 * begin + there])
    places = np.empty(len(begins), _PLACE)
    places["channel"] = channels
    places["offset"] = start + length + 15 * np.arange(len(begins)) + 16 * begins
    span, raw = (int(rows["time"].min()), int(rows["time"].max())), places.tobytes()
    content = struct.pack("<QQQQI", *span, start, length, len(raw)) + raw
    indexes = b"".join(parts)
    content += struct.pack("<QIQQ", len(indexes), 0, size, size)
    counts = dict(zip(channels.tolist(), (sizes // 16).tolist()))
    return indexes, Chunk(start, *span, counts, record(CHUNK_INDEX, content))


def totals(chunks: Sequence[Chunk]) -> tuple[Counter[int], tuple[int, int] | None]:
    """Return the messages of each channel, and their first and last time in [ns], if any."""
    counts: Counter[int] = Counter()
    for chunk in chunks:
        counts.update(chunk.counts)
    span = (min(c.first for c in chunks), max(c.last for c in chunks)) if chunks else None
    return counts, span


def attachment(name: str, stamp_ns: int, data: bytes) -> bytes:
    """Return the record of a JSON file that goes along, such as a trace."""
    content = struct.pack("<QQ", stamp_ns, stamp_ns) + packed_text(name)
    content += packed_text("application/json")
    content += struct.pack("<Q", len(data)) + data
    return record(ATTACHMENT, content + struct.pack("<I", zlib.crc32(content)))


def metadata(name: str, values: Mapping[str, str]) -> bytes:
    """Return the record of facts under a name."""
    return record(METADATA, packed_text(name) + _map(values))


def index_of(written: bytes, position: int) -> bytes:
    """Return the entry in the summary of an attachment or metadata record.

    Args:
        written: the record.
        position: where it stands in the file.

    Raises:
        struct.error, ValueError: it is not whole.
    """
    place = struct.pack("<QQ", position, len(written))
    if written[0] == METADATA:
        return record(METADATA_INDEX, place + written[9 : text_at(written, 9)[1]])
    end = text_at(written, text_at(written, 25)[1])[1]
    size = struct.pack("<Q", *struct.unpack_from("<Q", written, end))
    return record(ATTACHMENT_INDEX, place + written[9:25] + size + written[25:end])


def text_at(raw: Buffer, at: int) -> tuple[str, int]:
    """Return the text at a place of a record, and where it ends.

    Raises:
        struct.error, ValueError: there is none, or it is cut off.
    """
    (length,) = struct.unpack_from("<I", raw, at)
    if at + 4 + length > len(raw):
        raise ValueError("a text is cut off")
    return bytes(raw[at + 4 : at + 4 + length]).decode(), at + 4 + length


def walk(raw: memoryview, begin: int = len(MAGIC)) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, begin and end of the content of the records that are whole."""
    while begin + 9 <= len(raw):
        opcode, length = struct.unpack_from("<BQ", raw, begin)
        begin += 9
        if begin + length > len(raw):
            return
        yield opcode, begin, begin + length
        begin += length


def packed_text(text: str) -> bytes:
    raw = text.encode()
    return struct.pack("<I", len(raw)) + raw


def _map(values: Mapping[str, str]) -> bytes:
    raw = b"".join(packed_text(each) for item in values.items() for each in item)
    return struct.pack("<I", len(raw)) + raw


MOST_BYTES = 1 << 26
"""Of messages of one topic that wait for the medium: 2.4 s of 640 x 480 colours at 30 Hz."""

SOON_BYTES = 1 << 22
"""With so much they are written at once, and not with the rest after 0.7 s."""

_HEAD = MESSAGE_HEAD.size


class Large:
    """Large messages of one topic on their way into a file: one thread copies, another writes them.

    Memory is taken once per message that waits at the same time, and used again. A thread that
    copies holds Python's lock for some microseconds: NumPy copies without it.

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

    @property
    def failed(self) -> int:
        """Messages that are not in the file."""
        return self.crowded + self.lost

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
