"""A bag folder that is being written: `NAME_0.mcap`, `NAME_1.mcap`, … and `metadata.yaml`.

That is how `ros2 bag` keeps a recording of several files. A next one begins where the present one
is long enough; each is finished as any recording is, and tells by itself what its ticks mean.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from unicon_base.errors import UniconError
from unicon_lab.recording.mcap_file import (
    MESSAGE,
    MESSAGE_HEAD,
    METADATA,
    ROW,
    Buffer,
    Channel,
    McapFile,
    metadata,
)
from unicon_lab.recording.ticks import TOPIC

VERSION = 5
"""Of `metadata.yaml`: the one that Humble writes and all later releases read."""
_UNITS = {"kb": 1e3, "mb": 1e6, "gb": 1e9, "s": 1e9, "min": 60e9, "h": 3600e9}
_TIMES = ("s", "min", "h")


@dataclass(frozen=True)
class Split:
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
            value = round(float(told[1]) * _UNITS[unit]) if told and unit in _UNITS else 0
            if not value:
                raise UniconError(
                    f"a recording cannot be split at {part!r}; give a size or a time, such as "
                    "500MB, 1GB, 60s, 10min, or both: 1GB,10min"
                )
            size, time = (size, value) if unit in _TIMES else (value, time)
        return cls(size, time)


@dataclass(frozen=True)
class BagFile:
    """What `metadata.yaml` says of a file.

    Attributes:
        name: in the folder.
        counts: topic to its messages.
        span: first and last time in [ns], or None.
    """

    name: str
    counts: dict[str, int]
    span: tuple[int, int] | None


class BagFolder:
    """The folder, to write to as to one `McapFile`. No method is called from two threads at once.

    Args:
        path: of the folder, which does not exist; it is made.
        split: where a next file begins.

    Attributes:
        path: as given.
        messages: in whole chunks of all files.
        size: of all files in [bytes].
        again: of the messages those that files begin with anew.

    Raises:
        OSError: it cannot be written.
    """

    def __init__(self, path: Path, split: Split) -> None:
        self.path, self._split = path, split
        self._channels: list[Channel] = []
        self._facts: list[bytes] = []
        self._latched: list[tuple[int, bytes]] = []
        self._done: list[BagFile] = []
        self._files: list[McapFile] = []
        self._ticks = self.again = 0
        self._began = 0  # time of the present file's first message in [ns]
        path.mkdir()
        try:
            self._file: McapFile | None = self._opened(0)
        except BaseException:
            path.rmdir()
            raise

    def _opened(self, number: int) -> McapFile:
        self._files.append(McapFile(self.path / f"{self.path.name}_{number}.mcap"))
        return self._files[-1]

    @property
    def channels(self) -> int:
        """Number of channels."""
        return len(self._channels)

    @property
    def messages(self) -> int:
        """Messages in whole chunks of all files."""
        return sum(file.messages for file in self._files)

    @property
    def size(self) -> int:
        """Length of all files in [bytes]."""
        return sum(file.size for file in self._files)

    @property
    def partial(self) -> Path:
        """Where the present file grows."""
        return self.path if self._file is None else self._file.partial

    def begin(self) -> None:
        """Begin the first file."""
        self._present().begin()

    def add(self, channel: Channel) -> None:
        """Add a topic to all files."""
        self._present().add(channel)
        self._channels.append(channel)

    def latch(self, channel: int, message: bytes) -> None:
        """Let every next file begin with this message, as late joiners of its topic would."""
        self._latched.append((channel, message))

    def add_record(self, written: bytes) -> None:
        """Add an attachment to the present file, or metadata, which the next ones have too."""
        self._present().add_record(written)
        if written[0] == METADATA:
            self._facts.append(written)

    def write(self, records: Buffer, rows: NDArray[np.void]) -> None:
        """Write messages as one chunk, to the next file where the present one is long enough."""
        file, last = self._present(), int(rows["time"].max())
        size, time = self._split.size, self._split.time
        if file.messages and (
            (size and file.size + len(records) > size) or (time and last - self._began >= time)
        ):
            self._end()
            self._next(int(rows["time"].min()))
            file = self._present()
        elif not file.messages:
            self._began = int(rows["time"].min())
        file.write(records, rows)

    def _next(self, began: int) -> None:
        file = self._file = self._opened(len(self._done))
        file.begin()
        for facts in self._facts:
            file.add_record(facts)
        file.add_record(metadata("unicon", {"first_row": str(self._ticks)}))
        for channel in self._channels:
            file.add(channel)
        self._began = began
        records = bytearray()
        places: list[tuple[int, int, int]] = []
        for number, message in self._latched:
            places.append((number, began, len(records)))
            length = MESSAGE_HEAD.size - 9 + len(message)
            records += MESSAGE_HEAD.pack(MESSAGE, length, number, 0, began, began) + message
        if places:
            file.write(records, np.array(places, ROW))
            self.again += len(places)

    def _end(self) -> int:
        """Finish the present file; return how many messages that cost."""
        file = self._present()
        self._file = None
        lost = file.finish()
        topics = {channel.number: channel.topic for channel in self._channels}
        counts = {topics[number]: count for number, count in file.counts().items()}
        self._done.append(BagFile(file.path.name, counts, file.span()))
        self._ticks += counts.get(TOPIC, 0)
        told = {each.topic: (each.type, each.qos) for each in self._channels}
        write_metadata(self.path, self._done, told)
        return lost

    def _present(self) -> McapFile:
        if self._file is None:
            raise OSError(None, "no next file could be begun")
        return self._file

    def sync(self) -> None:
        """Bring the present file to the medium; from another thread too."""
        file = self._file
        try:
            if file is not None:
                file.sync()
        except OSError:
            if self._file is file:  # else it has just been finished, which syncs it
                raise

    def gone(self) -> bool:
        """Tell whether somebody deleted the present file."""
        return self._file is not None and self._file.gone()

    def finish(self) -> int:
        """Finish the present file; return how many messages that cost."""
        if self._file is None:
            return 0
        if not self._file.messages and self._done:
            self._file.discard()
            self._file = None
            return 0
        return self._end()

    def forget(self) -> int:
        """Close the present file, where it was deleted; return how many messages were in it."""
        lost = self._present().forget()
        self._file = None
        return lost

    def leave(self) -> None:
        """Close it as it is."""
        if self._file is not None:
            self._file.leave()

    def discard(self) -> None:
        """Close and delete it; other files in the folder stay, and the folder with them."""
        if self._file is not None:
            self._file.discard()
        with suppress(OSError):
            self.path.rmdir()


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
    listed = [
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
    ]
    spans = [file.span for file in files if file.span is not None]
    whole = (min(a for a, _ in spans), max(b for _, b in spans)) if spans else None
    content = {
        "version": VERSION,
        "storage_identifier": "mcap",
        **_times(whole),
        "message_count": counts.total(),
        "topics_with_message_count": listed,
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


def _times(span: tuple[int, int] | None) -> dict[str, Any]:
    first, last = span or (0, 0)
    return {
        "starting_time": {"nanoseconds_since_epoch": first},
        "duration": {"nanoseconds": last - first},
    }
