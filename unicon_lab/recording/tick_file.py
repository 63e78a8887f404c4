"""Files of ticks that are written in one go: fault records, and what is imported."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from unicon_base.errors import UniconError, cannot
from unicon_core.page import ROOM, refuse_existing
from unicon_core.runtime.tick_ring import HEAD
from unicon_core.states import Layout
from unicon_lab.recording.ticks import layout_facts
from unicon_lab.recording.mcap_file import (
    MESSAGE,
    MESSAGE_HEAD,
    ROW,
    Buffer,
    FileInUse,
    McapFile,
    metadata,
)
from unicon_lab.recording.ticks import RecordedSubset, tick_channel

CHUNK_BYTES = 1 << 18


def add_ticks(file: McapFile, ticks: Iterable[Buffer]) -> None:
    """Write ticks to the first channel of a file.

    Args:
        file: open.
        ticks: each as CDR, with its `HEAD`.

    Raises:
        OSError: it cannot be written.
    """
    records = bytearray()
    rows: list[tuple[int, int, int]] = []

    def chunk() -> None:
        file.write(bytes(records), np.array(rows, ROW))
        records.clear()
        rows.clear()

    for raw in ticks:
        stamp = max(int(HEAD.unpack_from(raw)[1]), 0)  # times in MCAP are unsigned
        rows.append((1, stamp, len(records)))
        size = MESSAGE_HEAD.size + len(raw)
        records += MESSAGE_HEAD.pack(MESSAGE, size - 9, 1, 0, stamp, stamp)
        records += raw
        if len(records) > CHUNK_BYTES:
            chunk()
    if rows:
        chunk()


def write_ticks(
    path: Path,
    layout: Layout,
    kept: RecordedSubset,
    facts: Mapping[str, str],
    ticks: Iterable[Buffer],
) -> int:
    """Write a record of ticks; return how many. What goes wrong leaves no file.

    Args:
        path: of the file, which does not exist.
        layout: of the states.
        kept: moment to the states that are kept there; None for all.
        facts: besides those of the layout.
        ticks: each as CDR, with its `HEAD`.

    Raises:
        UniconError: it exists, or cannot be written.
    """
    refuse_existing(path)
    with cannot(f"write {path}", ROOM):
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            file = McapFile(path)
        except FileInUse:
            raise UniconError(
                f"{path} is being written by another process; give another name"
            ) from None
        try:
            file.begin()
            file.add_record(metadata("unicon", {**facts, **layout_facts(layout, kept)}))
            file.add(tick_channel(1, layout, kept))
            add_ticks(file, ticks)
            if file.finish():
                path.unlink()
                raise UniconError(f"cannot write {path}: the medium is full; {ROOM}")
        except BaseException:
            file.discard()
            raise
    return file.messages
