"""Recorded frames: pictures and clouds of a recording by the handles that its ticks hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from unicon_ros.recording.records import MESSAGE_HEAD
from unicon_ros.recording.scan import Scan
from unicon_ros.recording.tick_message import FRAMES

_HEAD = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("handle", "<u4"),
        ("log", "<u8"),
        ("stamp", "<u8"),
    ]
)
"""`MESSAGE_HEAD`; the sequence is the frame's handle, of which 32 bits are kept."""


@dataclass(frozen=True, eq=False)
class Frames:
    """The frames of one ring, by their handles. Their files are mapped: what is asked for is read.

    Attributes:
        type: message type of each.
        handles: number of each, growing, shape (frames,).
        stamps: when each was true in [ns], shape (frames,).
    """

    type: str
    handles: NDArray[np.int64]
    stamps: NDArray[np.int64]
    _places: Sequence[tuple[NDArray[np.uint8], int, int]]

    def message(self, index: int) -> memoryview:
        """Return a frame as it was: a whole message, CDR."""
        data, begin, length = self._places[index]
        return memoryview(data.data)[begin : begin + length]

    def at(self, handles: NDArray[np.int64]) -> NDArray[np.int64]:
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
    places: list[tuple[NDArray[np.uint8], int, int]] = []
    heads: list[NDArray[np.void]] = []
    for scan in scans:
        begins = scan.frames.get(FRAMES + name)
        if begins is None:
            continue
        kind = next(kind for topic, kind in scan.topics.values() if topic == FRAMES + name)
        size = MESSAGE_HEAD.size
        raw = [scan.data[at - size : at] for at in begins.tolist()]
        found = np.concatenate(raw or [np.zeros(0, np.uint8)]).view(_HEAD)
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
