"""Recovery: finishes a recording that was cut off by a kill or a power loss.

For `unicon bag recover`; `unicon run --record` does so by itself when it finds one of that name.
"""

from __future__ import annotations

import os
import shutil
import struct
import zlib
from pathlib import Path

import numpy as np

from unicon_base.errors import UniconError, cannot
from unicon_lab.recording.bag_folder import BagFile, write_metadata
from unicon_lab.recording.mcap_file import (
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
    FileInUse,
    McapFile,
    index_of,
    message_indexes,
)
from unicon_lab.recording.read import files_of, missing
from unicon_lab.recording.scan import scan

LONGEST = 1 << 30
"""No record of ours is longer; a length beyond is rubble of a power loss."""

REST = 1 << 26
"""More than a kill or a power loss leaves torn, in [bytes], a 4K picture of 25 MB among it: what is
behind it may be worth more."""

_OURS = (HEADER, SCHEMA, CHANNEL, CHUNK, ATTACHMENT, METADATA)


def salvage(file: McapFile, most: int | None = None) -> None:
    """Take in what is whole in an open file; it then ends there.

    Args:
        file: it.
        most: how much behind that may be cut away in [bytes]; None for anything.

    Raises:
        ValueError: it does not begin as a recording does.
        UniconError: more would be cut away; it is left as it is.
    """
    position = len(MAGIC)
    if file.read(position, 0) != MAGIC:
        raise ValueError
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
            file.chunks.append(chunk)
            file.messages += sum(chunk.counts.values())
            position += chunk.indexes_length
        elif opcode in (ATTACHMENT, METADATA):
            try:
                file.others.append(index_of(record, position))
            except struct.error:
                break
        elif opcode != HEADER:
            (file.schemas if opcode == SCHEMA else file.topics).append(record)
        position += len(record)
        whole = position
    if not whole:
        raise ValueError
    if most is not None and file.read(1, whole + most):
        raise UniconError(
            f"{file.partial} is damaged {whole / 1e6:.1f} MB behind its beginning, and more than "
            f"{most / 1e6:.0f} MB stand behind that; rename it to end in .mcap, and unicon bag "
            "recover finishes a copy of what is before"
        )
    file.cut(whole)


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


def recover(path: str | Path, final_name: bool = False) -> tuple[Path, int] | None:
    """Finish a recording that was cut off, as `FILE.recovered-N.mcap` beside it.

    What follows the last whole chunk is cut away; it is at most the last half second. Where it is
    more than `REST` the file was damaged otherwise, and is left as it is.

    Args:
        path: `FILE.mcap.partial`; of a `FILE.mcap` without its end a copy is finished.
        final_name: finish it as `FILE.mcap`, which it would have become.

    Returns:
        Where it is now and its number of messages; None where a run was killed before there was one
        in it, and then it is deleted.

    Raises:
        UniconError: it is written at this moment, is not a recording, is damaged far from its end,
            cannot be written, or is a `FILE.mcap` without a whole message.
    """
    path = Path(path)
    if not os.path.exists(path):  # of a name that is too long, too
        raise UniconError(missing(path))
    if path.suffix == ".mcap" and path.is_file():
        copy = _copied(path)
        try:
            done = _recovered(copy, path, final_name=False, most=None)
        except UniconError:
            copy.unlink(missing_ok=True)
            raise
        if done is None:
            raise UniconError(
                f"{path} has no whole message of a recording in it: there is nothing to recover; "
                "give what a killed run left (FILE.mcap.partial), or move it away"
            )
        return done
    return _recovered(path, path, final_name, REST)


def _recovered(
    path: Path, given: Path, final_name: bool, most: int | None
) -> tuple[Path, int] | None:
    final = path.with_name(path.name.removesuffix(".partial"))
    if final == path or not path.is_file():
        raise UniconError(_no_recording(given))
    with cannot(f"recover {path}", "make room, move it away or give another name"):
        try:
            file = McapFile(final)
        except FileInUse:
            raise UniconError(
                f"recording {path} is being written by another run; let that end first, or give "
                "another name"
            ) from None
        try:
            if file.read(1, 0):  # else killed before its first byte
                salvage(file, most)
            if not file.messages:
                file.discard()
                return None
            number, target = 0, final
            while not final_name and (not number or target.exists()):
                number += 1
                target = final.with_name(f"{final.stem}.recovered-{number}.mcap")
            file.finish(target)
        except ValueError:
            raise UniconError(_no_recording(given)) from None
        finally:
            file.leave()
    return target, file.messages


def _copied(path: Path) -> Path:
    """Return a copy of a file without its end, which `recover` takes."""
    partial = path.with_name(f"{path.name}.partial")
    try:
        if scan(path).ended:
            raise UniconError(f"{path} is whole; there is nothing to recover")
    except (OSError, ValueError, struct.error):
        pass  # damaged: what stands before it is whole
    if partial.exists():
        raise UniconError(f"{partial} exists; recover it first, or move it away")
    with cannot(f"read {path}", "check the path"), path.open("rb") as file:
        begins = file.read(len(MAGIC))
    if begins != MAGIC[: len(begins)]:  # before terabytes of something else are copied
        raise UniconError(_no_recording(path))
    with cannot(f"write {partial}", "make room there"):
        try:
            shutil.copyfile(path, partial)
        except BaseException:  # Ctrl-C, too
            partial.unlink(missing_ok=True)
            raise
    return partial


def recover_folder(folder: Path) -> list[tuple[Path, int]]:
    """Finish what a killed run left in a bag folder, and write its `metadata.yaml` anew.

    Returns:
        The files of the folder, each with its number of messages.

    Raises:
        UniconError: as of `recover`, or there is no recording in the folder.
    """
    for path in files_of(folder):
        if path.suffix == ".partial":
            recover(path, final_name=True)
    files: list[BagFile] = []
    topics: dict[str, tuple[str, str]] = {}
    runs: set[str | None] = set()
    for path in files_of(folder):
        try:
            found = scan(path)
        except (OSError, ValueError, struct.error) as error:
            raise UniconError(
                f"{path} cannot be read: {error}; move it away from the others"
            ) from error
        runs.add(found.facts.get("run"))
        if len(runs) > 1:
            raise UniconError(
                f"{path} is of another run than the files before it: a folder is one bag; move it "
                "to a folder of its own"
            )
        for topic, kind in found.topics.values():
            topics[topic] = (kind, found.qos[topic])
        files.append(BagFile(path.name, found.messages(), found.span))
    with cannot(f"write {folder / 'metadata.yaml'}", "make room there"):
        write_metadata(folder, files, topics)
    return [(folder / file.name, sum(file.counts.values())) for file in files]


def recover_aside(folder: Path) -> tuple[Path, int] | None:
    """Finish what a killed run left in a bag folder, and call it `FOLDER.recovered-N`.

    A folder where no file has a message is deleted.

    Returns:
        Where it is now and its number of messages; None where nothing was left, or the folder is
        another, which is left as it is.

    Raises:
        UniconError: as of `recover_folder`.
        OSError: it cannot be renamed or deleted.
    """
    rest = [path for path in folder.iterdir() if path.name.endswith(".mcap.partial")]
    for path in rest:
        recover(path, final_name=True)
    if not rest:
        return None
    if not any(folder.iterdir()):
        folder.rmdir()
        return None
    files = recover_folder(folder)
    number = 1
    while (target := folder.with_name(f"{folder.name}.recovered-{number}")).exists():
        number += 1
    return folder.rename(target), sum(count for _, count in files)


def _no_recording(path: Path) -> str:
    return f"{path} is not a recording that a killed run left; move it away or give another name"
