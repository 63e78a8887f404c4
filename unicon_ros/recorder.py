"""Recorder: writes messages and ticks into an MCAP file.

`ros2 bag play`, rosbags and Foxglove read it; `open_record` reads the ticks to the bit. While it
grows it is called `FILE.partial`; what a killed run left of that name is finished as
`FILE.recovered-N.mcap`, or `FOLDER.recovered-N`, when the next one begins.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from unicon_core.errors import UniconError
from unicon_msgs_map import Qos
from unicon_msgs_map.layout.messages import Messages, shared_messages
from unicon_ros.recording import Background, McapFile, recover
from unicon_ros.recording.bag_folder import BagFolder, Split
from unicon_ros.recording.mcap_file import Buffer, Taken
from unicon_ros.recording.offered_qos import offered_qos
from unicon_ros.recording.records import Channel
from unicon_ros.recording.recover import recover_aside
from unicon_ros.recording.tick_message import Kept, tick_channel

if TYPE_CHECKING:
    from unicon_core.states import Layout
    from unicon_msgs_map.layout.messages import MessageDefinition
    from unicon_ros.recording.large import Large


class Recorder(Background):
    """An MCAP file that is being written; what goes wrong at its beginning is told in a line.

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
        warn: Callable[[str], None] = print,
        patient: bool = False,
        split: Split | None = None,
    ) -> None:
        self.path = Path(path)
        self._split = split or Split()
        self._folder = split is not None or str(path).endswith(os.sep)
        if self._folder and self.path.suffix == ".mcap":
            raise UniconError(
                f"recording {path} is split into files of a folder: give a name without .mcap"
            )
        self._clear(warn)
        if os.path.lexists(self.path):  # a link that points nowhere too
            raise UniconError(f"recording {path} exists; move it away or give another name")
        super().__init__(self._create(), warn, patient)

    def _clear(self, warn: Callable[[str], None]) -> None:
        """Move what an earlier run was cut off at out of the way."""
        rest = self.path.with_name(f"{self.path.name}.partial")
        found = None
        try:
            if self._folder and self.path.is_dir():
                found = recover_aside(self.path)
            elif not self._folder and rest.exists() and not os.path.lexists(self.path):
                found = recover(rest)
        except OSError as error:
            raise self._cannot(error) from error
        if found is not None:
            warn(
                f"an earlier run was cut off while it recorded to {self.path}; its "
                f"{found[1]} messages are in {found[0]} now"
            )

    def _create(self) -> McapFile | BagFolder:
        file: McapFile | BagFolder
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            file = BagFolder(self.path, self._split) if self._folder else McapFile(self.path)
        except Taken:
            raise UniconError(
                f"recording {self.path} is being written by another run; give another name"
            ) from None
        except OSError as error:
            raise self._cannot(error) from error
        try:
            file.begin()
        except OSError as error:
            file.discard()
            raise self._cannot(error) from error
        return file

    def _cannot(self, error: OSError) -> UniconError:
        return UniconError(
            f"cannot record to {self.path}: {error.strerror}; give a path in a writable folder "
            "with room"
        )

    def channel(
        self,
        topic: str,
        kind: str,
        messages: Messages | None = None,
        qos: Qos | None = None,
        latched: bytes = b"",
    ) -> Callable[[int, Buffer], bool]:
        """Add a topic, before `start`, and return what takes its messages: `write(stamp_ns, cdr)`.

        Args:
            topic: its name, after namespace and remaps.
            kind: its message type, `sensor_msgs/msg/JointState`.
            messages: where that type is defined; None for one of Jazzy or our own.
            qos: of who publishes it; None where nobody does.
            latched: a message that every later file of a bag folder begins with.

        Raises:
            MessageTypeError: the type is unknown.
            UniconError: it cannot be written.
        """
        known = (messages or shared_messages()).definition(kind)
        channel = self._described(topic, known, offered_qos(qos) if qos is not None else "")
        if latched and isinstance(self._file, BagFolder):
            self._file.latch(channel.number, latched)
        try:
            return self.add(channel)
        except OSError as error:
            raise self._cannot(error) from error

    def _described(self, topic: str, known: MessageDefinition, qos: str = "") -> Channel:
        return Channel(
            self._file.channels + 1,
            f"/{topic.lstrip('/')}",
            known.name,
            known.text,
            known.encoding,
            known.rihs,
            qos,
        )

    def large_channel(self, topic: str, kind: str, nbytes: int) -> Large:
        """Add a topic of large messages, before `start`, and return what takes them.

        Args:
            topic: its name.
            kind: its message type.
            nbytes: of the largest message.

        Raises:
            UniconError: it cannot be written.
        """
        try:
            known = shared_messages().definition(kind)
            return self.add_large(self._described(topic, known), nbytes)
        except OSError as error:
            raise self._cannot(error) from error

    def tick_channel(self, layout: Layout, kept: Kept) -> Callable[[int, Buffer], bool]:
        """Add the channel of ticks, before `start`, and return what takes them."""
        try:
            return self.add(tick_channel(self._file.channels + 1, layout, kept))
        except OSError as error:
            raise self._cannot(error) from error
