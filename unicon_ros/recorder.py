"""Recorder: writes the messages of a run and every tick into MCAP, for `unicon run --record`.

`ros2 bag play`, rosbags and Foxglove read it; `open_record` reads the ticks to the bit. While it
grows it is called `FILE.partial`; what a killed run left of that name is finished as
`FILE.recovered-N.mcap`, or `FOLDER.recovered-N`, when the next one begins.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from unicon_core.errors import MissingDependencyError, UniconError
from unicon_core.flow import Block, Stage
from unicon_msgs_map import Qos
from unicon_msgs_map.layout.messages import Messages, shared_messages
from unicon_ros.recorded_ticks import RecordedTicks
from unicon_ros.recording import Background, McapFile, recover
from unicon_ros.recording.bag_folder import BagFolder, Split
from unicon_ros.recording.mcap_file import Buffer, Taken
from unicon_ros.recording.offered_qos import offered_qos
from unicon_ros.recording.records import Channel
from unicon_ros.recording.recover import recover_aside
from unicon_ros.recording.tick_message import Kept, tick_channel

if TYPE_CHECKING:
    from unicon_core.runtime.statistics import TickStatistics
    from unicon_core.runtime.tick_ring import TickRing
    from unicon_core.states import Layout
    from unicon_core.workflow import Program
    from unicon_msgs_map.layout.messages import MessageDefinition
    from unicon_ros.bridge import RosSession
    from unicon_ros.recorded_frames import RecordedFrames
    from unicon_ros.recorded_topics import RecordedTopics
    from unicon_ros.recording.large import Large

__all__ = ["Recorder", "Recording", "names_in"]


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


class Recording:
    """Records the messages of a run, what came in and what goes out, and every state of every tick.

        recording = Recording("walk.mcap")
        record = FaultRecord(recording=recording)
        program = load_workflow("go2_walk", hooks=[recording.hook, record.hook])
        runner = Runner(program)
        record.attach(runner)

    Args:
        path: of the MCAP file.
        map_name: message map, name or path; `default` if None.
        session: where ROS is on, its messages are recorded as they leave, encoded once; the hook
            must then stand behind the session's own.
        warn: takes warnings, one line each, from a thread.
        patient: wait for a slow disk rather than drop messages: for runs at full speed.
        split: where a next file of a bag folder begins, such as `1GB` or `60s`; "" for nowhere.
        namespace: of relative topics, where there is no session.
        frame_prefix: of the names of frames, where there is no session.
        frames: handles whose pictures and clouds are recorded, without `_handle`, or `all`.
        jpeg: quality from 1 to 100 of pictures that are raw, 0 to leave them as they are.

    Raises:
        MissingDependencyError: rosbags is not installed.
        UniconError: nothing can be split so, or that is not a quality.
    """

    def __init__(
        self,
        path: str | Path,
        map_name: str | None = None,
        session: RosSession | None = None,
        warn: Callable[[str], None] = print,
        patient: bool = False,
        split: str = "",
        namespace: str = "",
        frame_prefix: str = "",
        frames: Sequence[str] = (),
        jpeg: int = 0,
    ) -> None:
        try:
            import rosbags  # noqa: F401  (the texts of the message types are its)
        except ModuleNotFoundError as error:
            raise MissingDependencyError(
                "--record", "rosbags", "pip install 'unicon_ros[bags]'"
            ) from error
        if not 0 <= jpeg <= 100:
            raise UniconError(f"{jpeg} is not a quality of a JPEG; give 1 to 100, or 0 for none")
        self._path, self._map_name, self._session = path, map_name, session
        self._namespace, self._frame_prefix = namespace, frame_prefix
        self._warn, self._patient = warn, patient
        self._split = Split.of(split) if split else None
        self._recorder: Recorder | None = None
        self._ticks: RecordedTicks | None = None
        self._wanted, self._jpeg = tuple(frames), jpeg
        self._frames: RecordedFrames | None = None
        self._statistics: TickStatistics | None = None

    def counts(self) -> dict[str, Any]:
        """Return messages in the file, those dropped, bytes, and the error or "".

        Where frames are recorded, `frames` tells of each ring how many were taken and missed.
        """
        counts = {} if self._recorder is None else self._recorder.counts()
        return counts if self._frames is None else counts | {"frames": self._frames.counts()}

    def summary(self) -> str:
        """Return what became of it, for the end of a run."""
        counts = self.counts()
        text = f"{self._path}: {counts['messages']} messages"
        if counts["dropped"]:
            text += f", {counts['dropped']} lost"
        for name, frames in counts.get("frames", {}).items():
            missed = f", {frames['missed']} missed" if frames["missed"] else ""
            text += f", {frames['frames']} frames of {name}{missed}"
        return text + (f" ({counts['error']})" if counts["error"] else "")

    def hook(self, program: Program) -> dict[Stage, list[Block]]:
        """Return the block that records."""
        # A robot does not wait for a disk, however its run is paced.
        patient = self._patient and program.platform.facts.simulated
        from unicon_ros.recorded_topics import RecordedTopics

        recorder = Recorder(self._path, self._warn, patient, self._split)
        try:
            names = (self._namespace, self._frame_prefix)
            topics = RecordedTopics(recorder, program, self._map_name, self._session, *names)
            if self._wanted:
                self._add_frames(recorder, program, topics)
        except BaseException:
            recorder.close()
            raise
        self._recorder, topics.block.close = recorder, self._close
        return {Stage.OBSERVE: [topics.block]}

    def _add_frames(self, recorder: Recorder, program: Program, topics: RecordedTopics) -> None:
        from unicon_ros.recorded_frames import RecordedFrames, chosen_sources

        sources = chosen_sources(program, self._wanted)
        self._frames = RecordedFrames(recorder, sources, topics.now, self._jpeg, self._warn)

    def _close(self) -> None:
        assert self._recorder is not None
        if self._frames is not None:
            self._frames.close()
        if self._ticks is not None and self._statistics is not None:
            self._ticks.close(self._statistics)
        self._recorder.close()

    def keep(self, ring: TickRing) -> None:
        """Record the ticks that a ring keeps; behind the hook."""
        assert self._recorder is not None
        self._ticks = RecordedTicks(self._recorder, ring)

    def attach(self, facts: Mapping[str, str], statistics: TickStatistics) -> None:
        """Get facts and statistics of the run, and begin to write, before the first tick."""
        assert self._recorder is not None
        self._statistics = statistics
        if self._ticks is not None:
            self._ticks.attach(facts)
        self._recorder.start()
        if self._frames is not None:
            self._frames.start()


def names_in(text: str) -> list[str]:
    """Return the names that stand in a text with commas between them."""
    return [name.strip() for name in text.split(",") if name.strip()]
