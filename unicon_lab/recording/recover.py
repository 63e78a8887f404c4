"""Recovery: finishes a recording that was cut off by a kill or a power loss.

For `unicon bag recover`; `unicon run --record` does so by itself when it finds one of that name.
"""

from __future__ import annotations

import os
import shutil
import struct
import zlib
from itertools import count
from pathlib import Path

import numpy as np

from unicon_base import UniconError, cannot
from unicon_lab.recording.bag_folder import BagFile, write_metadata
from unicon_lab.recording.mcap_file import McapFile
from unicon_lab.recording.read import files_of, missing
from unicon_lab.recording.records import (
    ATTACHMENT,
    CHANNEL,
    CHUNK,
    CHUNK_HEAD,
    HEADER,
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD,
    MESSAGE_INDEX,
    METADATA,
    ROW,
    SCHEMA,
    Chunk,
    index_of,
    indexed,
    walk,
)
from unicon_lab.recording.scan import scan

LONGEST = 1 << 30
"""No record of ours is longer; a length beyond is rubble of a power loss."""

REST = 1 << 26
"""More than a kill or a power loss leaves torn, in [bytes], a 4K picture of 25 MB among it: bytes
behind it may be worth more."""


def salvage(file: McapFile, most: int | None = None) -> None:
    """Take in what is whole in an open file; it then ends there.

    Args:
        file: that was cut off.
        most: how much behind that may be cut away in [bytes]; None for anything.

    Raises:
        ValueError: it does not begin as a recording does.
        UniconError: more would be cut away; it is left as it is.
    """
    raw, whole = file.content(), 0
    if raw[: len(MAGIC)] != MAGIC:
        raise ValueError
    for opcode, begin, end in walk(raw):
        if opcode == MESSAGE_INDEX and end <= whole:
            continue
        if end - begin > LONGEST:
            break
        written = raw[begin - 9 : end]
        if opcode == CHUNK:
            found = _chunk(written, begin - 9)
            if found is None or raw[end : end + len(found[0])] != found[0]:
                break
            end += len(found[0])
            file.chunks.append(found[1])
            file.messages += sum(found[1].counts.values())
        elif opcode in (ATTACHMENT, METADATA):
            try:
                file.others.append(index_of(bytes(written), begin - 9))
            except (struct.error, ValueError):
                break
        elif opcode in (SCHEMA, CHANNEL):
            (file.schemas if opcode == SCHEMA else file.topics).append(bytes(written))
        elif opcode != HEADER:
            break
        whole = end
    if not whole:
        raise ValueError
    if most is not None and len(raw) > whole + most:
        raise UniconError(
            f"{file.partial} is damaged {whole / 1e6:.1f} MB behind its beginning, and more than "
            f"{most / 1e6:.0f} MB stand behind that; rename it to end in .mcap, and unicon bag "
            "recover finishes a copy of what is before"
        )
    file.cut(whole)


def _chunk(written: memoryview, start: int) -> tuple[bytes, Chunk] | None:
    """Return the message indexes that a chunk must have and the chunk, None where it is not whole.

    Args:
        written: its record.
        start: of the record in the file.
    """
    try:
        _, _, _, _, size, crc, _, _ = CHUNK_HEAD.unpack_from(written)
        records = written[CHUNK_HEAD.size :]
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
    return indexed(np.array(found, ROW), start, size) if found else None


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
    given = path = Path(path)
    if not os.path.exists(path):  # of a name that is too long, too
        raise UniconError(missing(path))
    copied = path.suffix == ".mcap" and path.is_file()
    path = _copied(path) if copied else path
    try:
        done = _recovered(path, given, final_name, None if copied else REST)
    except UniconError:
        if copied:
            path.unlink(missing_ok=True)
        raise
    if copied and done is None:
        raise UniconError(
            f"{given} has no whole message of a recording in it: there is nothing to recover; "
            "give what a killed run left (FILE.mcap.partial), or move it away"
        )
    return done


def _recovered(
    path: Path, given: Path, final_name: bool, most: int | None
) -> tuple[Path, int] | None:
    target = path.with_name(path.name.removesuffix(".partial"))
    if target == path or not path.is_file():
        raise _no_recording(given)
    with cannot(f"recover {path}", "make room, move it away or give another name"):
        file = McapFile(target)
        try:
            if path.stat().st_size:  # else killed before its first byte
                salvage(file, most)
            if not file.messages:
                file.discard()
                return None
            if not final_name:
                target = _free(target, f"{target.stem}.recovered-{{}}.mcap")
            file.finish(target)
        except ValueError:
            raise _no_recording(given) from None
        finally:
            file.leave()
    return target, file.messages


def _free(path: Path, form: str) -> Path:
    """Return the first name beside a path that is not taken."""
    return next(p for n in count(1) if not (p := path.with_name(form.format(n))).exists())


def _copied(path: Path) -> Path:
    """Return a copy of a file without its end, for `_recovered`."""
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
        raise _no_recording(path)
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
        topics |= {topic: (kind, found.qos[topic]) for topic, kind in found.topics.values()}
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
    rest = list(folder.glob("*.mcap.partial"))
    for path in rest:
        recover(path, final_name=True)
    if not rest:
        return None
    if not any(folder.iterdir()):
        folder.rmdir()
        return None
    files = recover_folder(folder)
    target = _free(folder, f"{folder.name}.recovered-{{}}")
    return folder.rename(target), sum(number for _, number in files)


def _no_recording(path: Path) -> UniconError:
    return UniconError(
        f"{path} is not a recording that a killed run left; move it away or give another name"
    )
