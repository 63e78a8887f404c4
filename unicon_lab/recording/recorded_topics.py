"""RecordedTopics: the messages of a run on their way into a recording, under their full names.

What leaves and what comes in is recorded as the very bytes, one copy each. What nobody publishes,
since ROS is off or a type is not installed, is encoded for the recording, after `send`.
"""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from unicon_base import TextSink, UniconError, alternatives, imported, one_line
from unicon_base.arrays import UInt8
from unicon_base.resources import find_config
from unicon_core.flow import Block
from unicon_lab.recording.background import calm
from unicon_lab.recording.ticks import FRAMES
from unicon_msgs_map import Encoder, MapStateError, MessageMap, load_map
from unicon_ros.bridge.bindings import arrays_of, checked_prefix, names_of, robot_variables
from unicon_ros.bridge.diagnostics import CLOCK
from unicon_ros.bridge.images import JPEG, STAMP, FrameMessage, as_jpeg, jpeg_message
from unicon_ros.bridge.qos import LATCHED
from unicon_ros.bridge.robot_frames import TF_MESSAGE, RobotMessages
from unicon_ros.bridge.ros_platform import RosPlatform
from unicon_ros.bridge.topics import prepared

if TYPE_CHECKING:
    from unicon_core.workflow import Program
    from unicon_lab.recording.background import Write
    from unicon_lab.recording.recorder import Recorder
    from unicon_msgs_map.spec import TopicSpec
    from unicon_ros.bridge import RosSession
    from unicon_ros.peripheral import FrameSource


class RecordedTopics:
    """Taps what passes; `block` records the rest, and the latched topics in the first tick.

    Args:
        recorder: not started yet; it gets a channel for each topic.
        program: whose messages they are.
        map_name: message map, name or path; `default` if None.
        session: where ROS is on; its map counts then.
        namespace: of relative topics, where there is no session.
        frame_prefix: of the names of frames, where there is no session.

    Raises:
        UniconError: the map does not fit, or the file cannot be written.
    """

    def __init__(
        self,
        recorder: Recorder,
        program: Program,
        map_name: str | None = None,
        session: RosSession | None = None,
        namespace: str = "",
        frame_prefix: str = "",
    ) -> None:
        self._recorder, self._program, self._session = recorder, program, session
        self._namespace = namespace.strip("/")
        self._simulated = program.platform.facts.simulated
        self._stamp = program.states["stamp_ns"].reshape(-1)
        self._writes: dict[tuple[str, str], Write] = {}
        self._latched: list[tuple[Write, bytes]] = []
        self._due: list[tuple[int, Callable[[], bytes], Write]] = []
        self._reads: set[str] = set()
        self._tick = 0
        taken = self._passing()
        if session is not None:
            mapping, frame_prefix = session.map, session.frame_prefix
        else:
            mapping = load_map(find_config("maps", map_name or "default"))
            frame_prefix = checked_prefix(frame_prefix)
        self._map(mapping, taken, frame_prefix)
        self._robot(frame_prefix)
        reads = tuple(sorted(self._reads))
        self.block = Block("recorder", self._record, reads=reads, close=recorder.close)

    def _passing(self) -> set[str]:
        """Tap what comes in and what a robot behind topics is sent; return these topics."""
        platform, session = self._program.platform, self._session
        behind = platform if isinstance(platform, RosPlatform) else None
        incoming = [*(behind.incoming if behind else ()), *(session.incoming if session else ())]
        taken: set[str] = set()
        for topic in incoming:
            if topic.topic not in taken:  # both may hear one: each message once
                taken.add(topic.topic)
                topic.tap = self._tap(topic.topic, topic.spec)
        for out in behind.outgoing if behind else ():
            taken.add(out.topic)
            out.tap = self._tap(out.topic, out.spec)
        return taken

    def _map(self, mapping: MessageMap, taken: set[str], frame_prefix: str) -> None:
        """Record what the map publishes, at its rates."""
        program, session = self._program, self._session
        arrays = session.arrays if session else arrays_of(program)  # with its wall clock
        variables = robot_variables(program.robot, frame_prefix)
        leaving = {id(out.spec): out for out in session.outgoing} if session else {}
        for spec in mapping.publish:
            out = leaving.get(id(spec))
            if out is not None and out.topic not in taken:
                out.tap = self._tap(out.topic, spec)
                continue
            topic = self._resolved(spec.topic)
            if topic in taken or (spec.topic == CLOCK and not self._simulated):
                continue
            try:
                self._encode(topic, Encoder.build(spec, arrays, names_of(program), variables))
            except MapStateError:
                if not spec.optional:
                    raise

    def _robot(self, frame_prefix: str) -> None:
        """Record the robot's description and frames."""
        frames = self._session.frames if self._session else None
        if frames is not None:
            messages = frames.messages
        else:
            stamp = arrays_of(self._program)["stamp_ns"]
            try:
                messages = RobotMessages(self._program, stamp, frame_prefix)
            except UniconError:  # it has no model
                messages = None
        if messages is None:
            return
        if messages.description:
            described = string_message(messages.description)
            self._latch("robot_description", "std_msgs/msg/String", described)
        if messages.static:
            self._latch("/tf_static", TF_MESSAGE, messages.static)
        outs = {} if frames is None else {out.spec.topic: out for out in frames.outs}
        for out in outs.values():
            out.tap = self._tap(out.topic, out.spec)
        if "/tf" not in outs and messages.links is not None:
            self._encode(self._resolved("/tf"), messages.links, messages.update)
            self._reads.update(messages.reads)

    # -- helpers --------------------------------------------------------------------------------

    def _channel(self, topic: str, spec: TopicSpec) -> Write:
        """Return what takes messages of a topic; several publishers share one."""
        write = self._writes.get((topic, spec.type))
        if write is None:
            write = self._recorder.channel(topic, spec.type, spec.messages, spec.qos)
            self._writes[topic, spec.type] = write
        return write

    def _tap(self, topic: str, spec: TopicSpec) -> Callable[[bytes], object]:
        write, now = self._channel(topic, spec), self.now
        return lambda raw: write(now(), raw)

    def _encode(
        self, topic: str, encoder: Encoder, prepare: Callable[[], None] | None = None
    ) -> None:
        spec, encode = encoder.spec, encoder.encode
        if prepare is not None:
            encode = prepared(prepare, encode)
        due = spec.every(self._program.period), encode, self._channel(topic, spec)
        self._due.append(due)
        self._reads.update(state for state in spec.states if state in self._program.states)

    def _latch(self, topic: str, kind: str, message: bytes) -> None:
        write = self._recorder.channel(self._resolved(topic), kind, None, LATCHED, message)
        self._latched.append((write, message))

    def _resolved(self, topic: str) -> str:
        if self._session is not None:
            return str(self._session.node.resolve_topic_name(topic))
        if topic.startswith("/"):
            return topic
        return "/".join(["", *filter(None, [self._namespace]), topic.replace("~", "unicon", 1)])

    def now(self) -> int:
        """Return the time of a message that is recorded now, [ns]."""
        return int(self._stamp[0]) if self._simulated else time.time_ns()

    def _record(self) -> None:
        tick = self._tick
        if not tick:
            self._recorder.start()  # where nobody attached it to a runner
            for write, message in self._latched:
                write(self.now(), message)
        for every, encode, write in self._due:
            if tick % every == 0:
                write(self.now(), encode())
        self._tick = tick + 1


def string_message(text: str) -> bytes:
    """Return a std_msgs/String as CDR: its length with the NUL at the end, then UTF-8."""
    raw = text.encode()
    return b"\x00\x01\x00\x00" + struct.pack("<I", len(raw) + 1) + raw + b"\x00"


ALL = "all"
"""The word for every ring that a workflow has."""

INTERVAL = 0.01
"""How often the rings are looked at, in [s]: a third of the time of a picture at 30 Hz, of which a
ring keeps three."""


def chosen_sources(program: Program, names: Sequence[str]) -> dict[str, FrameSource]:
    """Return the rings whose frames are to be recorded, by the names of their handles.

    Args:
        program: whose blocks have them.
        names: of handles without `_handle`, or `all`.

    Raises:
        UniconError: there is none of such a name.
    """
    there: dict[str, FrameSource] = {}
    for block in program.blocks:
        there |= getattr(block.tick, "sources", {})
    if not there:
        raise UniconError(
            "--record-frames: no block of the workflow has pictures or clouds; add one, such as "
            "camera or webcam, or leave it out"
        )
    for name in names:
        if name not in (*there, ALL):
            raise UniconError(
                f"--record-frames: no frames {name!r}; {alternatives(name, [*there, ALL])}"
            )
    return {name: there[name] for name in there if ALL in names or name in names}


class RecordedFrames:
    """Copies frames into a recording from a thread of its own.

    Args:
        recorder: not started yet; it gets a topic for each ring.
        sources: name of a handle without `_handle` to its ring.
        now: tells the time of the recording's messages, [ns].
        jpeg: quality from 1 to 100 of pictures that are raw, 0 to leave them as they are.
        warn: takes a warning, from the thread.

    Raises:
        UniconError: the file cannot be written.
        MissingDependencyError: a picture is to be a JPEG, and Pillow is not installed.
    """

    def __init__(
        self,
        recorder: Recorder,
        sources: Mapping[str, FrameSource],
        now: Callable[[], int],
        jpeg: int = 0,
        warn: TextSink = print,
    ) -> None:
        self._streams = {
            name: _Stream(recorder, name, source, jpeg) for name, source in sources.items()
        }
        self._now, self._warn = now, warn
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._work, name="recorder frames", daemon=True)

    def counts(self) -> dict[str, dict[str, int]]:
        """Return for each ring the frames that are in the file, and those that are not."""
        return {
            name: {"frames": each.large.written, "missed": each.missed + each.large.failed}
            for name, each in self._streams.items()
        }

    def start(self) -> None:
        """Start the thread; safe to call twice."""
        if self._thread.ident is None:
            self._thread.start()

    def close(self) -> None:
        """Take what is there, and end; safe to call twice. The recorder is closed behind it."""
        self._ended.set()
        if self._thread.ident is not None:
            self._thread.join(1.0)

    def _work(self) -> None:
        calm()
        streams = tuple(self._streams.values())
        ending = False
        while not ending:
            ending = self._ended.wait(INTERVAL)
            try:
                for stream in streams:
                    if stream.ring.latest != stream.seen:
                        stream.take(self._now())
            except Exception as error:  # whatever it is, the run goes on
                self._warn(f"frames are recorded no longer: {one_line(error)}")
                return


class _Stream:
    """One ring and its topic."""

    def __init__(self, recorder: Recorder, name: str, source: FrameSource, jpeg: int) -> None:
        self.ring, message = source.ring, source.message
        colour = message.dtype == "|u1" and len(message.shape) == 3  # 8 bits for each of three
        self._jpeg = _Jpeg(message, jpeg) if jpeg and colour else None
        self._cut = message.offset if message.type == JPEG else 0
        kind = message.type if self._jpeg is None else JPEG
        self.large = recorder.large_channel(FRAMES + name, kind, self.ring.nbytes)
        self.seen = self.ring.latest  # of frames before the run, the newest
        self.seen -= self.seen > 0
        self.missed = 0

    def take(self, now: int) -> None:
        """Take the frames that are new."""
        ring, latest = self.ring, self.ring.latest
        for handle in range(self.seen + 1, latest + 1):
            frame, stamp_ns, length = ring.frame(handle), ring.stamp_ns(handle), 0
            if frame is not None:
                room = self.large.room()
                if room is None:  # which counts it
                    continue
                np.copyto(room, frame)
                if ring.holds(handle):  # else overwritten meanwhile
                    length = len(room)
                    if self._cut:
                        length = self._cut + struct.unpack_from("<I", room.data, self._cut - 4)[0]
                    elif self._jpeg is not None:
                        length = self._jpeg(room)
                    length *= length <= len(room)
            if length > 0:
                self.large.put(length, handle, now, stamp_ns)
            else:
                self.missed += 1
        self.seen = latest


class _Jpeg:
    """Makes a JPEG of a picture, in its place."""

    def __init__(self, message: FrameMessage, quality: int) -> None:
        imported("PIL.Image", "--record-jpeg", "lerobot", "pillow")
        self._from, self._quality = message, quality
        self._to = jpeg_message(0, message.frame_id)

    def __call__(self, room: UInt8) -> int:
        """Replace the picture of a message by its JPEG; return the new length, 0 if it is longer.

        Args:
            room: a whole message, shape (bytes,).
        """
        data = as_jpeg(self._from.data(room.data), self._from.shape, self._quality)
        head = bytearray(self._to.template)
        if len(head) + len(data) > len(room):
            return 0
        head[STAMP] = room[STAMP].tobytes()
        room[: len(head)] = np.frombuffer(head, np.uint8)
        return self._to.put(room.data, memoryview(data))
