"""Reading of a fault record, for replay and analysis: `open_record(PATH).states("joint_pos")`."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import StateError, UniconError
from unicon_core.runtime.tick_ring import HEAD
from unicon_core.states import Layout, States
from unicon_ros.recording.records import (
    ATTACHMENT,
    CHUNK,
    CHUNK_HEAD,
    DATA_END,
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD,
    METADATA,
)

__all__ = ["Record", "open_record"]

_WRONG = (
    ArithmeticError,
    LookupError,
    RecursionError,
    StateError,
    TypeError,
    ValueError,
    struct.error,
)


@dataclass(frozen=True)
class Record:
    """A record of ticks, to the bit.

    Attributes:
        facts: reason, workflow, robot, versions, … as texts.
        layout: of the states.
        moments: what is kept of a tick: `received`, …, `sent`.
        stamps: time of each tick in [ns], shape (ticks,).
        ticks: number of each, shape (ticks,).
        phases: phase of each, as text.
        ended: False for the tick in which the fault was, shape (ticks,).
        buffers: moment to the packed states, uint8, shape (ticks, layout.nbytes).
        memories: what the blocks remembered: `before` (index of a tick), `anew` (the flow was
            reset before it), and what `Memory.restore` takes.
        files: name to content of what goes along: `report.json`, `trace.json`.
    """

    facts: Mapping[str, str]
    layout: Layout
    moments: tuple[str, ...]
    stamps: NDArray[np.int64]
    ticks: NDArray[np.int64]
    phases: tuple[str, ...]
    ended: NDArray[np.bool_]
    buffers: Mapping[str, NDArray[np.uint8]]
    memories: list[dict[str, Any]]
    files: Mapping[str, bytes]

    def states(self, name: str, moment: str = "sent") -> NDArray[Any]:
        """Return a state in every tick, shape (ticks, …).

        Raises:
            StateError: no such state.
        """
        slot = self.layout.slots.get(name)
        if slot is None or moment not in self.buffers:
            raise StateError(
                f"no state {name!r} at {moment!r} in the record; states: "
                f"{', '.join(self.layout.slots)}; moments: {', '.join(self.moments)}"
            )
        packed = self.buffers[moment][:, slot.offset : slot.offset + slot.nbytes]
        return np.ascontiguousarray(packed).view(slot.dtype).reshape(-1, *slot.shape)

    def feed(self, moment: str, row: int, states: States) -> None:
        """Put what came from outside at a moment of a tick into live states of the same layout.

        Args:
            moment: `received`, `input` or `tuned`.
            row: of the tick.
            states: with all that the moments before left.
        """
        states.buffer[:] = self.buffers[moment][row]


def open_record(path: str | Path) -> Record:
    """Read a fault record; of one that a kill cut off, what is whole.

    Raises:
        UniconError: it cannot be read, or is not such a record.
    """
    try:
        raw = Path(path).read_bytes()
    except OSError as error:
        raise UniconError(f"cannot read {path}: {error.strerror}") from error
    try:
        return _record(raw)
    except _WRONG as error:
        raise UniconError(
            f"{path} is not a fault record: {error}; give one that unicon wrote"
        ) from error


def _record(raw: bytes) -> Record:
    facts: dict[str, str] = {}
    files: dict[str, bytes] = {}
    rows: list[memoryview] = []
    if not raw.startswith(MAGIC):
        raise ValueError("it does not begin as MCAP does")
    for opcode, content in _records(memoryview(raw), len(MAGIC)):
        if opcode == METADATA:
            facts |= _metadata(content)
        elif opcode == ATTACHMENT:
            name, data = _attachment(content)
            files[name] = data
        elif opcode == CHUNK:
            head = CHUNK_HEAD.size - 9
            inner = content[head:]
            if zlib.crc32(inner) != CHUNK_HEAD.unpack_from(bytes(9) + content[:head])[5]:
                raise ValueError("a chunk is damaged")
            rows += [c[MESSAGE_HEAD.size - 9 :] for o, c in _records(inner, 0) if o == MESSAGE]
        elif opcode == DATA_END:
            break
    layout = Layout.from_json(facts["layout"])
    moments = tuple(json.loads(facts["moments"]))
    names = json.loads(facts["phases"])
    width = HEAD.size + len(moments) * layout.nbytes
    if any(len(row) != width for row in rows):
        raise ValueError("its ticks are of another layout")
    table = np.frombuffer(b"".join(rows), np.uint8).reshape(-1, width)
    heads = [HEAD.unpack_from(row) for row in rows]
    buffers = {
        moment: table[:, begin : begin + layout.nbytes]
        for moment, begin in zip(moments, range(HEAD.size, width, layout.nbytes))
    }
    memories = json.loads(files.get("memory.json", b'{"memories": []}'))["memories"]
    return Record(
        facts,
        layout,
        moments,
        np.array([head[1] for head in heads], np.int64),
        np.array([head[2] for head in heads], np.int64),
        tuple(names[head[3]] for head in heads),
        np.array([head[4] for head in heads], np.bool_),
        buffers,
        memories,
        files,
    )


def _records(raw: memoryview, position: int) -> Iterator[tuple[int, memoryview]]:
    """Yield opcode and content of the records that are whole."""
    while position + 9 <= len(raw):
        opcode, length = struct.unpack_from("<BQ", raw, position)
        position += 9
        if position + length > len(raw):
            return
        yield opcode, raw[position : position + length]
        position += length


def _text(raw: memoryview, at: int) -> tuple[str, int]:
    (length,) = struct.unpack_from("<I", raw, at)
    return bytes(raw[at + 4 : at + 4 + length]).decode(), at + 4 + length


def _metadata(raw: memoryview) -> dict[str, str]:
    _, at = _text(raw, 0)
    at += 4
    values: dict[str, str] = {}
    while at < len(raw):
        key, at = _text(raw, at)
        values[key], at = _text(raw, at)
    return values


def _attachment(raw: memoryview) -> tuple[str, bytes]:
    name, at = _text(raw, 16)
    _, at = _text(raw, at)
    (length,) = struct.unpack_from("<Q", raw, at)
    data = bytes(raw[at + 8 : at + 8 + length])
    if struct.unpack_from("<I", raw, at + 8 + length)[0] != zlib.crc32(raw[:-4]):
        raise ValueError(f"{name} is damaged")
    return name, data
