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
from unicon_lab.recording.mcap_file import (
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
)
from unicon_lab.recording.ticks import FRAMES, TOPIC

Span: TypeAlias = tuple[int, int]

_HEAD = CHUNK_HEAD.size - 9
_BODY = MESSAGE_HEAD.size - 9


@dataclass
class Scan:
    """What stands in a file.

    Attributes:
        data: the file, mapped, shape (bytes,).
        facts: of the metadata record `unicon`.
        files: name to content of the attachments.
        topics: number of a channel to its topic and type.
        qos: topic to the QoS of its publisher, where the file tells it; see `offered_qos`.
        counts: number of a channel to its messages.
        ticks: where the bytes of each tick stand in the file, shape (ticks,).
        sizes: of each in [bytes], shape (ticks,).
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
    sizes: Int64 = field(default_factory=lambda: np.zeros(0, np.int64))
    frames: dict[str, Int64] = field(default_factory=dict)
    span: Span | None = None
    ended: bool = False

    def messages(self) -> Counter[str]:
        """Return the number of messages of each topic."""
        found: Counter[str] = Counter()
        for number, count in self.counts.items():
            found[self.topics.get(number, (f"channel {number}", ""))[0]] += count
        return found


def gather(data: UInt8, places: Int64, size: int) -> UInt8:
    """Return the `size` bytes at each place, shape (places, size)."""
    if not size or not len(places):
        return np.zeros((len(places), size), np.uint8)
    # Items that overlap: one for each byte, so that a place is an index.
    items = np.ndarray((len(data) - size + 1,), f"V{size}", data, strides=(1,))
    packed: UInt8 = items[places].view(np.uint8)
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
        if path.stat().st_size < len(MAGIC):
            raise ValueError("it does not begin as MCAP does")
        raw = memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
    if raw[: len(MAGIC)] != MAGIC:
        raise ValueError("it does not begin as MCAP does")
    found = Scan(np.frombuffer(raw, np.uint8))
    torn = path.suffix == ".partial"
    places: dict[str, list[Int64]] = {}
    types: dict[int, str] = {}
    chunk: Span | None = None  # whose message indexes follow
    indexes: dict[int, Span] = {}

    def settle() -> None:
        if chunk is not None:
            for topic, begins in _messages(found, chunk, indexes):
                places.setdefault(topic, []).append(begins)

    for opcode, begin, end in _records(raw, len(MAGIC), len(raw)):
        if opcode == MESSAGE_INDEX:
            number, size = struct.unpack_from("<HI", raw, begin)
            indexes[number] = (begin + 6, size)
            continue
        settle()
        chunk, indexes = None, {}
        if opcode == METADATA:
            name, values = _metadata(raw[begin:end])
            if name == "unicon":
                found.facts.update(values)
        elif opcode == ATTACHMENT:
            name, content = _attachment(raw[begin:end])
            found.files[name] = content
        elif opcode == SCHEMA:
            types[struct.unpack_from("<H", raw, begin)[0]] = _text(raw, begin + 2)[0]
        elif opcode == CHANNEL:
            number, schema = struct.unpack_from("<HH", raw, begin)
            topic, after = _text(raw, begin + 4)
            found.topics[number] = (topic, types.get(schema, ""))
            found.qos[topic] = _qos(raw[after:end])
        elif opcode == CHUNK:
            _, _, first, last, _, crc, named, _ = CHUNK_HEAD.unpack_from(raw, begin - 9)
            if named:
                raise ValueError("its chunks are compressed; write it anew without compression")
            if zlib.crc32(raw[begin + _HEAD : end]) != crc:
                if torn:
                    break
                raise ValueError("a chunk is damaged")
            chunk = (begin + _HEAD, end)
            before = found.span or (first, last)
            found.span = (min(first, before[0]), max(last, before[1]))
        elif opcode == DATA_END:
            found.ended = True
            break
    settle()
    joined = {topic: np.concatenate(each) for topic, each in places.items()}
    found.ticks = joined.pop(TOPIC, found.ticks)
    found.frames = joined
    lengths = gather(found.data, found.ticks - _BODY - 8, 8).reshape(-1).view("<i8")
    found.sizes = lengths.astype(np.int64) - _BODY
    if (found.ticks + found.sizes > len(found.data)).any():
        raise ValueError("a message index is damaged")
    return found


def _messages(found: Scan, chunk: Span, indexes: dict[int, Span]) -> Iterator[tuple[str, Int64]]:
    """Count the messages of a chunk; yield where those of ticks and frames stand."""
    offsets: dict[int, Any] = {}
    if indexes:
        for number, (begin, size) in indexes.items():
            found.counts[number] += size // 16
            offsets[number] = found.data[begin : begin + size].view("<i8")[1::2]
    else:  # cut off behind it
        raw = found.data.data
        for opcode, begin, _ in _records(raw, *chunk):
            if opcode == MESSAGE:
                (number,) = struct.unpack_from("<H", raw, begin)
                found.counts[number] += 1
                offsets.setdefault(number, []).append(begin - 9 - chunk[0])
    for number, there in offsets.items():
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


def _records(raw: memoryview, position: int, until: int) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, begin and end of the content of the records that are whole."""
    while position + 9 <= until:
        opcode, length = struct.unpack_from("<BQ", raw, position)
        position += 9
        if position + length > until:
            return
        yield opcode, position, position + length
        position += length


def _text(raw: memoryview, at: int) -> tuple[str, int]:
    (length,) = struct.unpack_from("<I", raw, at)
    if at + 4 + length > len(raw):
        raise ValueError("a text is cut off")
    return bytes(raw[at + 4 : at + 4 + length]).decode(), at + 4 + length


def _metadata(raw: memoryview) -> tuple[str, dict[str, str]]:
    name, at = _text(raw, 0)
    at += 4
    values: dict[str, Any] = {}
    while at < len(raw):
        key, at = _text(raw, at)
        values[key], at = _text(raw, at)
    return name, values


def _qos(raw: memoryview) -> str:
    """Return the QoS that a channel tells behind its topic; "" where it cannot be read."""
    try:
        told = _metadata(raw)[1].get("offered_qos_profiles", "")
    except (ValueError, struct.error):  # messages can be read without it
        return ""
    return "" if told == "[]" else told


def _attachment(raw: memoryview) -> tuple[str, bytes]:
    name, at = _text(raw, 16)
    _, at = _text(raw, at)
    (length,) = struct.unpack_from("<Q", raw, at)
    data = bytes(raw[at + 8 : at + 8 + length])
    if struct.unpack_from("<I", raw, at + 8 + length)[0] != zlib.crc32(raw[:-4]):
        raise ValueError(f"{name} is damaged")
    return name, data


# `MESSAGE_HEAD`; the sequence is the frame's handle, of which 32 bits are kept.
_FRAME = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("handle", "<u4"),
        ("log", "<u8"),
        ("stamp", "<u8"),
    ]
)


@dataclass(frozen=True, eq=False)
class Frames:
    """The frames of one ring, by their handles. Their files are mapped: what is asked for is read.

    Attributes:
        type: message type of each.
        handles: number of each, growing, shape (frames,).
        stamps: when each was true in [ns], shape (frames,).
    """

    type: str
    handles: Int64
    stamps: Int64
    _places: Sequence[tuple[UInt8, int, int]]

    def message(self, index: int) -> memoryview:
        """Return a frame as it was: a whole message, CDR."""
        data, begin, length = self._places[index]
        return memoryview(data.data)[begin : begin + length]

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
    kind = ""
    places: list[tuple[UInt8, int, int]] = []
    heads: list[NDArray[np.void]] = []
    for scan in scans:
        begins = scan.frames.get(FRAMES + name)
        if begins is None:
            continue
        kind = next(kind for topic, kind in scan.topics.values() if topic == FRAMES + name)
        size = MESSAGE_HEAD.size
        raw = [scan.data[at - size : at] for at in begins.tolist()]
        found = np.concatenate(raw or [np.zeros(0, np.uint8)]).view(_FRAME)
        heads.append(found)
        lengths = (found["length"] - np.uint64(size - 9)).tolist()
        places += [(scan.data, at, length) for at, length in zip(begins.tolist(), lengths)]
    if not places:
        return None
    head = np.concatenate(heads)
    order = np.argsort(head["handle"], kind="stable")
    return Frames(
        kind,
        head["handle"][order].astype(np.int64),
        head["stamp"][order].astype(np.int64),
        [places[row] for row in order.tolist()],
    )
