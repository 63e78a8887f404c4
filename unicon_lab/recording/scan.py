"""A look through an MCAP file of ours: where ticks and frames stand, what goes along; for readers.

The file is mapped, not read: a look costs a pass over its checksums, and no memory of its own.
"""

from __future__ import annotations

import mmap
import struct
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from unicon_base.arrays import Int64, UInt8
from unicon_lab.recording.records import (
    ATTACHMENT,
    CHANNEL,
    CHUNK,
    CHUNK_HEAD,
    DATA_END,
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD,
    MESSAGE_INDEX,
    METADATA,
    SCHEMA,
    text_at,
    walk,
)
from unicon_lab.recording.ticks import FRAMES, TOPIC

Span: TypeAlias = tuple[int, int]

# `MESSAGE_HEAD`; the sequence of a frame is its handle, of which 32 bits are kept.
_HEAD = np.dtype("u1,<u8,<u2,<u4,<u8,<u8")
_HEAD.names = ("opcode", "length", "channel", "handle", "log", "stamp")


@dataclass
class Scan:
    """What stands in a file.

    Attributes:
        data: the file, mapped, shape (bytes,).
        facts: of the metadata record `unicon`.
        files: name to content of the attachments.
        topics: number of a channel to its topic and type.
        qos: topic to the QoS of its publisher, where the file has it; see `offered_qos`.
        counts: number of a channel to its messages.
        ticks: where the bytes of each tick stand in the file, shape (ticks,).
        frames: topic of frames to where the bytes of each stand in the file, shape (frames,).
        span: first and last time of all messages in [ns], or None.
        ended: it has its end, so that nobody cut it off.
    """

    data: UInt8
    facts: dict[str, str] = field(default_factory=dict)
    files: dict[str, bytes] = field(default_factory=dict)
    topics: dict[int, tuple[str, str]] = field(default_factory=dict)
    qos: dict[str, str] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)
    ticks: Int64 = field(default_factory=lambda: np.zeros(0, np.int64))
    frames: dict[str, Int64] = field(default_factory=dict)
    span: Span | None = None
    ended: bool = False

    def messages(self) -> Counter[str]:
        """Return the number of messages of each topic."""
        found: Counter[str] = Counter()
        for number, count in self.counts.items():
            found[self.topics.get(number, (f"channel {number}", ""))[0]] += count
        return found

    def heads(self, begins: Int64) -> tuple[NDArray[np.void], Int64]:
        """Return the heads of messages by where their bytes stand, and the lengths of those."""
        heads = gather(self.data, begins - MESSAGE_HEAD.size, MESSAGE_HEAD.size)
        found = heads.view(_HEAD).reshape(-1)
        lengths = found["length"].astype(np.int64) - (MESSAGE_HEAD.size - 9)
        if (begins + lengths > len(self.data)).any():
            raise ValueError("a message index is damaged")
        return found, lengths


def gather(data: UInt8, places: Int64, size: int) -> UInt8:
    """Return the `size` bytes at each place, shape (places, size)."""
    if not size or not len(places):
        return np.zeros((len(places), size), np.uint8)
    # Items that overlap: one for each byte, so that a place is an index.
    items = np.ndarray((len(data) - size + 1,), f"V{size}", data, strides=(1,))
    packed = items[places].view(np.uint8)
    return packed.reshape(-1, size)


def scan(path: Path) -> Scan:
    """Look through a file; of one that a kill cut off, through what is whole.

    Raises:
        OSError: it cannot be read.
        ValueError, struct.error: it is not a file of ours, or damaged.
    """
    if path.exists() and not path.is_file():  # a pipe would never open
        raise ValueError("it is not a file")
    with path.open("rb") as file:
        if not path.stat().st_size:
            raise ValueError("it is empty")
        raw = memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
    if raw[: len(MAGIC)] != MAGIC:
        raise ValueError("it does not begin as MCAP does")
    found = Scan(np.frombuffer(raw, np.uint8))
    types: dict[int, str] = {}
    chunks: list[tuple[Span, dict[int, Span]]] = []  # each with its message indexes
    for opcode, begin, end in walk(raw):
        content = raw[begin:end]
        if opcode == MESSAGE_INDEX:
            number, size = struct.unpack_from("<HI", content)
            if chunks:
                chunks[-1][1][number] = (begin + 6, size)
        elif opcode == METADATA:
            name, at = text_at(content, 0)
            if name == "unicon":
                found.facts.update(_map(content[at:]))
        elif opcode == ATTACHMENT:
            name, data = _attachment(content)
            found.files[name] = data
        elif opcode == SCHEMA:
            types[struct.unpack_from("<H", content)[0]] = text_at(content, 2)[0]
        elif opcode == CHANNEL:
            number, schema = struct.unpack_from("<HH", content)
            topic, at = text_at(content, 4)
            found.topics[number] = (topic, types.get(schema, ""))
            found.qos[topic] = _qos(content[at:])
        elif opcode == CHUNK:
            _, _, first, last, _, crc, named, _ = CHUNK_HEAD.unpack_from(raw, begin - 9)
            if named:
                raise ValueError("its chunks are compressed; write it anew without compression")
            inner = begin - 9 + CHUNK_HEAD.size, end
            if zlib.crc32(raw[slice(*inner)]) != crc:
                if path.suffix == ".partial":
                    break
                raise ValueError("a chunk is damaged")
            chunks.append((inner, {}))
            before = found.span or (first, last)
            found.span = (min(first, before[0]), max(last, before[1]))
        elif opcode == DATA_END:
            found.ended = True
            break
    places: dict[str, list[Int64]] = {}
    for inner, indexes in chunks:
        for topic, begins in _messages(found, inner, indexes):
            places.setdefault(topic, []).append(begins)
    found.frames = {topic: np.concatenate(each) for topic, each in places.items()}
    found.ticks = found.frames.pop(TOPIC, found.ticks)
    return found


def _messages(found: Scan, chunk: Span, indexes: dict[int, Span]) -> Iterator[tuple[str, Int64]]:
    """Count the messages of a chunk; yield where those of ticks and frames stand."""
    offsets: dict[int, Any] = {
        number: found.data[begin : begin + size].view("<i8")[1::2]
        for number, (begin, size) in indexes.items()
    }
    if not indexes:  # cut off behind the chunk
        raw = found.data.data[: chunk[1]]
        for opcode, begin, _ in walk(raw, chunk[0]):
            if opcode == MESSAGE:
                (number,) = struct.unpack_from("<H", raw, begin)
                offsets.setdefault(number, []).append(begin - 9 - chunk[0])
    for number, there in offsets.items():
        found.counts[number] += len(there)
        topic, _ = found.topics.get(number, ("", ""))
        if topic != TOPIC and not topic.startswith(FRAMES):
            continue
        begins = chunk[0] + np.array(there, np.int64)
        if len(begins) and (
            begins.min() < chunk[0]
            or begins.max() + MESSAGE_HEAD.size > chunk[1]
            or (found.data[begins] != MESSAGE).any()
        ):
            raise ValueError("a message index is damaged")
        yield topic, begins + MESSAGE_HEAD.size


def _map(raw: memoryview) -> dict[str, str]:
    at, values = 4, {}
    while at < len(raw):
        key, at = text_at(raw, at)
        values[key], at = text_at(raw, at)
    return values


def _qos(raw: memoryview) -> str:
    """Return the QoS that a channel has behind its topic; "" where it cannot be read."""
    try:
        told = _map(raw[text_at(raw, 0)[1] :]).get("offered_qos_profiles", "")
    except (ValueError, struct.error):  # messages can be read without it
        return ""
    return "" if told == "[]" else told


def _attachment(raw: memoryview) -> tuple[str, bytes]:
    name, at = text_at(raw, 16)
    at = text_at(raw, at)[1]
    (length,) = struct.unpack_from("<Q", raw, at)
    end = at + 8 + length
    if struct.unpack_from("<I", raw, end)[0] != zlib.crc32(raw[:-4]):
        raise ValueError(f"{name} is damaged")
    return name, bytes(raw[at + 8 : end])


@dataclass(frozen=True, eq=False)
class Frames:
    """The frames of one ring, by their handles. Their files are mapped and read on demand.

    Attributes:
        type: message type of each.
        handles: number of each, growing, shape (frames,).
        stamps: when each was true in [ns], shape (frames,).
    """

    type: str
    handles: Int64
    stamps: Int64
    _messages: Sequence[memoryview]

    def message(self, index: int) -> memoryview:
        """Return a frame as it was: a whole message, CDR."""
        return self._messages[index]

    def at(self, handles: Int64) -> Int64:
        """Return for each handle the index of its frame, or of the newest one before it; else -1.

        Args:
            handles: of ticks, shape (ticks,); 0 for none.
        """
        found = np.searchsorted(self.handles, handles, "right") - 1
        return np.where(handles > 0, found, -1)


def frames_in(name: str, scans: Sequence[Scan]) -> Frames | None:
    """Return the frames of one ring, None where none were recorded.

    Args:
        name: of their handle without `_handle`.
        scans: of the files of one recording, in their order.
    """
    topic, types = FRAMES + name, dict[str, str]()
    heads: list[NDArray[np.void]] = []
    messages: list[memoryview] = []
    for each in scans:
        types |= dict(each.topics.values())
        begins = each.frames.get(topic, np.zeros(0, np.int64))
        found, lengths = each.heads(begins)
        heads.append(found)
        messages += [each.data.data[a:b] for a, b in np.stack([begins, begins + lengths], 1)]
    if not messages:
        return None
    head = np.concatenate(heads)
    order = np.argsort(head["handle"], kind="stable")
    return Frames(
        types[topic],
        head["handle"][order].astype(np.int64),
        head["stamp"][order].astype(np.int64),
        [messages[row] for row in order],
    )
