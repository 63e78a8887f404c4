"""Recovery: finishes a recording that was cut off by a kill or a power loss.

    python -m unicon_ros.recording.recover FILE.mcap.partial

`unicon run --record FILE.mcap` does so by itself when it finds one of that name.
"""

from __future__ import annotations

import argparse
import struct
import sys
import zlib
from pathlib import Path

import numpy as np

from unicon_core.errors import UniconError
from unicon_ros.recording.mcap_file import McapFile, Taken
from unicon_ros.recording.records import (
    ATTACHMENT,
    CHANNEL,
    CHUNK,
    CHUNK_HEAD,
    HEADER,
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD,
    METADATA,
    ROW,
    SCHEMA,
    Chunk,
    index_of,
    message_indexes,
)

__all__ = ["recover", "salvage"]

LONGEST = 1 << 30
"""No record of ours is longer; a length beyond is rubble of a power loss."""

_OURS = (HEADER, SCHEMA, CHANNEL, CHUNK, ATTACHMENT, METADATA)


def salvage(file: McapFile) -> None:
    """Take in what is whole in an open file; it then ends there.

    Raises:
        ValueError: it does not begin as a recording does.
    """
    position = len(MAGIC)
    if file.read(position, 0) != MAGIC:
        raise ValueError
    schemas: list[bytes] = []
    channels: list[bytes] = []
    chunks: list[Chunk] = []
    others: list[bytes] = []
    whole = 0
    while True:
        head = file.read(9, position)
        if len(head) < 9:
            break
        opcode, length = struct.unpack("<BQ", head)
        if opcode not in _OURS or length > LONGEST:
            break
        record = file.read(9 + length, position)
        if len(record) < 9 + length:
            break
        if opcode == CHUNK:
            chunk = _chunk(file, record, position)
            if chunk is None:
                break
            chunks.append(chunk)
            position += chunk.indexes_length
        elif opcode in (ATTACHMENT, METADATA):
            try:
                others.append(index_of(record, position))
            except struct.error:
                break
        elif opcode != HEADER:
            (schemas if opcode == SCHEMA else channels).append(record)
        position += len(record)
        whole = position
    if not whole:
        raise ValueError
    file.adopt(whole, schemas, channels, chunks, others)


def _chunk(file: McapFile, record: bytes, start: int) -> Chunk | None:
    """Return what is known of a chunk, None where it or its indexes are not whole."""
    try:
        _, _, _, _, size, crc, _, _ = CHUNK_HEAD.unpack_from(record)
        records = memoryview(record)[CHUNK_HEAD.size :]
        if len(records) != size or zlib.crc32(records) != crc:
            return None
        found: list[tuple[int, int, int]] = []
        position = 0
        while position < size:
            opcode, length, channel, _, time, _ = MESSAGE_HEAD.unpack_from(records, position)
            if opcode != MESSAGE:
                return None
            found.append((channel, time, position))
            position += 9 + length
    except struct.error:
        return None
    if not found:
        return None
    rows = np.array(found, ROW)
    indexes, offsets, counts = message_indexes(rows)
    if file.read(len(indexes), start + len(record)) != indexes:
        return None
    first, last = int(rows["time"].min()), int(rows["time"].max())
    return Chunk(start, len(record), size, first, last, offsets, len(indexes), counts)


def recover(path: str | Path) -> tuple[Path, int] | None:
    """Finish a recording that was cut off, as `FILE.recovered-N.mcap` beside it.

    What follows the last whole chunk is cut away; it is at most the last half second.

    Args:
        path: `FILE.mcap.partial`.

    Returns:
        Where it is now and its number of messages; None where there was none in it, and then it is
        deleted.

    Raises:
        UniconError: it is written at this moment, is not a recording, or cannot be written.
    """
    path = Path(path)
    final = path.with_name(path.name.removesuffix(".partial"))
    if final == path or not path.is_file():
        raise UniconError(_no_recording(path))
    try:
        file = McapFile(final)
    except Taken:
        raise UniconError(
            f"recording {path} is being written by another run; give another name"
        ) from None
    except OSError as error:
        raise UniconError(
            f"cannot recover {path}: {error.strerror}; move it away or give another name"
        ) from error
    try:
        if not file.read(1, 0):  # killed before its first byte
            file.discard()
            return None
        salvage(file)
        if not file.messages:
            file.discard()
            return None
        number = 1
        while (target := final.with_name(f"{final.stem}.recovered-{number}.mcap")).exists():
            number += 1
        file.finish(target)
    except ValueError:
        file.leave()
        raise UniconError(_no_recording(path)) from None
    except OSError as error:
        raise UniconError(
            f"cannot recover {path}: {error.strerror}; make room or give another name"
        ) from error
    return target, file.messages


def _no_recording(path: Path) -> str:
    return f"{path} is not a recording that a killed run left; move it away or give another name"


def main() -> int:
    """Recover the files that are named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", nargs="+", metavar="FILE.mcap.partial")
    status = 0
    for name in parser.parse_args().file:
        try:
            done = recover(name)
            print(f"{name}: no message in it" if done is None else f"{done[0]}: {done[1]} messages")
        except UniconError as error:
            print(f"unicon: error: {error}", file=sys.stderr)
            status = 1
    return status


if __name__ == "__main__":
    raise SystemExit(main())
