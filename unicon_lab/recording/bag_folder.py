"""A bag folder that is being written: `NAME_0.mcap`, `NAME_1.mcap`, … and `metadata.yaml`.

That is how `ros2 bag` keeps a recording of several files. A next one begins where the present one
is long enough; each is finished as any recording is, and holds the layout of its ticks itself.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml
from numpy.typing import NDArray

from unicon_base import AnyDict, UniconError
from unicon_lab.recording.mcap_file import McapFile
from unicon_lab.recording.records import (
    MESSAGE,
    MESSAGE_HEAD,
    METADATA,
    ROW,
    Buffer,
    Channel,
    metadata,
    totals,
)
from unicon_lab.recording.ticks import TOPIC

VERSION = 5
"""Of `metadata.yaml`: the one that Humble writes and all later releases read."""
_SIZES = {"kb": 1e3, "mb": 1e6, "gb": 1e9}
_TIMES = {"s": 1e9, "min": 60e9, "h": 3600e9}


class Split(NamedTuple):
    """Where a next file begins; 0 for nowhere.

    Attributes:
        size: in [bytes].
        time: of the messages in [ns].
    """

    size: int = 0
    time: int = 0

    @classmethod
    def of(cls, text: str) -> Split:
        """Read `1GB`, `60s`, or both with a comma; units are kB, MB, GB, s, min, h.

        Raises:
            UniconError: it is something else.
        """
        size = time = 0
        for part in filter(None, text.split(",")):
            told = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([A-Za-z]+)\s*", part)
            unit = told[2].lower() if told else ""
            value = round(float(told[1]) * (_SIZES | _TIMES).get(unit, 0)) if told else 0
            if not value:
                raise UniconError(
                    f"a recording cannot be split at {part!r}; give a size or a time, such as "
                    "500MB, 1GB, 60s, 10min, or both: 1GB,10min"
                )
            size, time = (size, value) if unit in _TIMES else (value, time)
        return cls(size, time)


class BagFile(NamedTuple):
    """What `metadata.yaml` says of a file.

    Attributes:
        name: in the folder.
        counts: topic to its messages.
        span: first and last time in [ns], or None.
    """

    name: str
    counts: Mapping[str, int]
    span: tuple[int, int] | None


class BagFolder(McapFile):
    """The folder, to write to as to one file: the attributes of `McapFile` are the present file's.

    Args:
        folder: does not exist; it is made.
        split: where a next file begins.

    Raises:
        OSError: it cannot be written.
    """

    def __init__(self, folder: Path, split: Split) -> None:
        self.folder, self._split = folder, split
        self._channels: list[Channel] = []
        self._facts: list[bytes] = []
        self._latched: list[tuple[int, bytes]] = []
        self._done: list[BagFile] = []
        self._ticks = 0
        self._began = 0  # time of the present file's first message in [ns]
        folder.mkdir()
        try:
            self._open()
        except BaseException:
            folder.rmdir()
            raise

    def _open(self) -> None:
        super().__init__(self.folder / f"{self.folder.name}_{len(self._done)}.mcap")

    def add(self, channel: Channel) -> None:
        """Add a topic to all files."""
        super().add(channel)
        self._channels.append(channel)

    def latch(self, channel: int, message: bytes) -> None:
        """Let every next file begin with this message, as late joiners of its topic would."""
        self._latched.append((channel, message))

    def add_record(self, written: bytes) -> None:
        """Add an attachment to the present file, or metadata, which the next ones have too."""
        super().add_record(written)
        if written[0] == METADATA:
            self._facts.append(written)

    def write(self, records: Buffer, rows: NDArray[np.void]) -> None:
        """Write messages as one chunk, to the next file where the present one is long enough."""
        first, last = int(rows["time"].min()), int(rows["time"].max())
        size, time = self._split
        if not self.messages:
            self._began = first
        elif (size and self.size + len(records) > size) or (time and last - self._began >= time):
            self._end()
            self._next(first)
        super().write(records, rows)

    def _next(self, began: int) -> None:
        self._open()
        self.begin()
        for facts in (*self._facts, metadata("unicon", {"first_row": str(self._ticks)})):
            super().add_record(facts)
        for channel in self._channels:
            super().add(channel)
        self._began = began
        records = bytearray()
        places: list[tuple[int, int, int]] = []
        for number, message in self._latched:
            places.append((number, began, len(records)))
            length = MESSAGE_HEAD.size - 9 + len(message)
            records += MESSAGE_HEAD.pack(MESSAGE, length, number, 0, began, began) + message
        if places:
            super().write(records, np.array(places, ROW))
            self.again += len(places)

    def _end(self) -> int:
        """Finish the present file; return how many messages that cost."""
        lost = super().finish()
        numbers, span = totals(self.chunks)
        topics = {each.topic: (each.type, each.qos) for each in self._channels}
        counts = {each.topic: numbers[each.number] for each in self._channels}
        self._done.append(BagFile(self.path.name, counts, span))
        self._ticks += counts.get(TOPIC, 0)
        self._before, self.messages, self.size = self.recorded, 0, 0
        write_metadata(self.folder, self._done, topics)
        return lost

    def finish(self, path: Path | None = None) -> int:
        """Finish the present file; return how many messages that cost."""
        if self._file >= 0 and not self.messages and self._done:
            super().discard()
        return self._end() if self._file >= 0 else 0

    def discard(self) -> None:
        """Close and delete it; other files in the folder stay, and the folder with them."""
        super().discard()
        with suppress(OSError):
            self.folder.rmdir()


def write_metadata(
    folder: Path, files: Sequence[BagFile], topics: Mapping[str, tuple[str, str]]
) -> None:
    """Write `metadata.yaml` of a bag folder, in one go.

    Args:
        folder: with the files.
        files: in their order.
        topics: each with its message type and its QoS, see `offered_qos`.

    Raises:
        OSError: it cannot be written.
    """
    counts: Counter[str] = Counter()
    for file in files:
        counts.update(file.counts)
    spans = [file.span for file in files if file.span is not None]
    content = {
        "version": VERSION,
        "storage_identifier": "mcap",
        **_times((min(a for a, _ in spans), max(b for _, b in spans)) if spans else None),
        "message_count": counts.total(),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic,
                    "type": kind,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": qos,
                },
                "message_count": counts[topic],
            }
            for topic, (kind, qos) in topics.items()
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file in files],
        "files": [
            {"path": file.name, **_times(file.span), "message_count": sum(file.counts.values())}
            for file in files
        ],
    }
    text = yaml.safe_dump({"rosbag2_bagfile_information": content}, sort_keys=False)
    partial = folder / "metadata.yaml.partial"
    with partial.open("w", encoding="utf-8") as stream:
        stream.write(text)
        stream.flush()
        os.fsync(stream.fileno())
    partial.replace(folder / "metadata.yaml")


def _times(span: tuple[int, int] | None) -> AnyDict:
    first, last = span or (0, 0)
    return {
        "starting_time": {"nanoseconds_since_epoch": first},
        "duration": {"nanoseconds": last - first},
    }
