"""Recorder: writes messages and ticks into an MCAP file.

`ros2 bag play`, rosbags and Foxglove read it; `open_record` reads the ticks bit-exact. While it
grows it is called `FILE.partial`; what a killed run left of that name is finished as
`FILE.recovered-N.mcap`, or `FOLDER.recovered-N`, when the next one begins.
"""

from __future__ import annotations

import os
from contextlib import AbstractContextManager
from pathlib import Path

import yaml

from unicon_base import AnyDict, TextSink, UniconError, cannot
from unicon_core.page import ROOM, refuse_existing
from unicon_core.states import Layout
from unicon_lab.recording import McapFile, recover
from unicon_lab.recording.background import Background, Write
from unicon_lab.recording.bag_folder import BagFolder, Split
from unicon_lab.recording.records import Channel, Large
from unicon_lab.recording.recover import recover_aside
from unicon_lab.recording.ticks import Names, RecordedSubset, tick_channel
from unicon_msgs_map import Qos
from unicon_msgs_map.layout.messages import Messages, shared_messages


class Recorder(Background):
    """An MCAP file that is being written; what goes wrong at its beginning is an error of one line.

    Args:
        path: of the file, must not exist; folders are made.
        warn: takes warnings, one line each, from a thread.
        patient: wait for a slow disk rather than drop messages.
        split: where a next file begins; then the path is that of a bag folder, as it is where it
            ends with a slash.

    Raises:
        UniconError: the file exists, or cannot be written.
    """

    def __init__(
        self,
        path: str | Path,
        warn: TextSink = print,
        patient: bool = False,
        split: Split | None = None,
    ) -> None:
        self.path, folder = Path(path), split is not None or str(path).endswith(os.sep)
        if folder and self.path.suffix == ".mcap":
            raise UniconError(
                f"recording {path} is split into files of a folder: give a name without .mcap"
            )
        with self._writing():
            found = self._cleared(folder)
        if found is not None:
            warn(
                f"an earlier run was cut off while it recorded to {self.path}; its "
                f"{found[1]} messages are in {found[0]} now"
            )
        refuse_existing(self.path, "recording ")
        with self._writing():
            self.path.parent.mkdir(parents=True, exist_ok=True)
            file = BagFolder(self.path, split or Split()) if folder else McapFile(self.path)
            try:
                file.begin()
            except OSError:
                file.discard()
                raise
        super().__init__(file, self.path, warn, patient)

    def _writing(self) -> AbstractContextManager[None]:
        return cannot(f"record to {self.path}", ROOM)

    def _cleared(self, folder: bool) -> tuple[Path, int] | None:
        """Move what a cut-off run left out of the way; return where, and its messages."""
        rest = self.path.with_name(f"{self.path.name}.partial")
        if folder:
            return recover_aside(self.path) if self.path.is_dir() else None
        return recover(rest) if rest.exists() and not os.path.lexists(self.path) else None

    def channel(
        self,
        topic: str,
        kind: str,
        messages: Messages | None = None,
        qos: Qos | None = None,
        latched: bytes = b"",
    ) -> Write:
        """Add a topic, before `start`, and return what takes its messages: `write(stamp_ns, cdr)`.

        Args:
            topic: its name, after namespace and remaps.
            kind: its message type, `sensor_msgs/msg/JointState`.
            messages: where that type is defined; None for one of Jazzy or our own.
            qos: of its publisher; None where there is none.
            latched: a message that every later file of a bag folder begins with.

        Raises:
            MessageTypeError: the type is unknown.
            UniconError: it cannot be written.
        """
        channel = self._described(topic, kind, messages, offered_qos(qos) if qos else "")
        if latched and isinstance(self._file, BagFolder):
            self._file.latch(channel.number, latched)
        with self._writing():
            return self.add(channel)

    def _described(
        self, topic: str, kind: str, messages: Messages | None = None, qos: str = ""
    ) -> Channel:
        known = (messages or shared_messages()).definition(kind)
        number, topic = len(self._file.topics) + 1, f"/{topic.lstrip('/')}"
        return Channel(number, topic, known.name, known.text, known.encoding, known.rihs, qos)

    def large_channel(self, topic: str, kind: str, nbytes: int) -> Large:
        """Add a topic of large messages, before `start`, and return what takes them.

        Args:
            topic: its name.
            kind: its message type.
            nbytes: of the largest message.

        Raises:
            UniconError: it cannot be written.
        """
        with self._writing():
            return self.add_large(self._described(topic, kind), nbytes)

    def tick_channel(self, layout: Layout, kept: RecordedSubset, names: Names) -> Write:
        """Add the channel of ticks, before `start`, and return what takes them."""
        with self._writing():
            return self.add(tick_channel(len(self._file.topics) + 1, layout, kept, names))


# Values of rmw/types.h.
_WORDS = {
    "history": {"keep_last": 1, "keep_all": 2},
    "reliability": {"reliable": 1, "best_effort": 2},
    "durability": {"transient_local": 1, "volatile": 2},
    "liveliness": {"automatic": 1, "manual_by_topic": 3},
}
# In [ns]; RMW_DURATION_INFINITE.
_FOREVER = (1 << 63) - 1


def offered_qos(qos: Qos) -> str:
    """Return `offered_qos_profiles` of a topic: YAML, a list of one profile.

    Args:
        qos: of the publisher, or of the subscription that received it.
    """
    words = {name: values[getattr(qos, name)] for name, values in _WORDS.items()}
    profile = words | {
        "depth": qos.depth,
        "deadline": _time(qos.deadline),
        "lifespan": _time(qos.lifespan),
        "liveliness_lease_duration": _time(qos.liveliness_lease),
        "avoid_ros_namespace_conventions": False,
    }
    return str(yaml.safe_dump([profile], sort_keys=False))


def _time(seconds: float | None) -> AnyDict:
    """Return a time in [s] as rosbag2 has it; None is for ever."""
    sec, nsec = divmod(_FOREVER if seconds is None else round(seconds * 1e9), 10**9)
    return {"sec": sec, "nsec": nsec}
