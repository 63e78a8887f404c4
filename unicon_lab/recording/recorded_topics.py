"""RecordedTopics: the messages of a run on their way into a recording, under their full names.

What leaves and what comes in is recorded as the very bytes, one copy each. What nobody publishes,
since ROS is off or a type is not installed, is encoded for the recording, after `send`.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from unicon_base.errors import UniconError
from unicon_base.resources import find_config
from unicon_core.flow import Block
from unicon_msgs_map import Encoder, MapStateError, MessageMap, load_map
from unicon_ros.bridge.bindings import arrays_of, checked_prefix, names_of, robot_variables
from unicon_ros.bridge.diagnostics import CLOCK
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
            mapping = session.map
        else:
            mapping = load_map(find_config("maps", map_name or "default"))
        frame_prefix = checked_prefix(frame_prefix) if session is None else session.frame_prefix
        self._map(mapping, taken, frame_prefix)
        self._robot(frame_prefix)
        self.block = Block(
            "recorder", self._record, reads=tuple(sorted(self._reads)), close=recorder.close
        )

    def _passing(self) -> set[str]:
        """Tap what comes in and what a robot behind topics is sent; return these topics."""
        taken: set[str] = set()
        platform = self._program.platform
        behind = platform if isinstance(platform, RosPlatform) else None
        incoming = [*behind.incoming] if behind is not None else []
        incoming += self._session.incoming if self._session is not None else []
        for topic in incoming:
            if topic.topic not in taken:  # both may hear one: each message once
                taken.add(topic.topic)
                topic.tap = self._tap(topic.topic, topic.spec)
        for out in [] if behind is None else behind.outgoing:
            taken.add(out.topic)
            out.tap = self._tap(out.topic, out.spec)
        return taken

    def _map(self, mapping: MessageMap, taken: set[str], frame_prefix: str) -> None:
        """Record what the map publishes, at its rates."""
        program, session = self._program, self._session
        arrays = arrays_of(program) if session is None else session.arrays  # with its wall clock
        variables = robot_variables(program.robot, frame_prefix)
        leaving = {id(out.spec): out for out in session.outgoing} if session is not None else {}
        for spec in mapping.publish:
            out = leaving.get(id(spec))
            if out is not None and out.topic not in taken:
                out.tap = self._tap(out.topic, spec)
                continue
            topic = self._resolved(spec.topic)
            if topic in taken or (spec.topic == CLOCK and not self._simulated):
                continue
            try:
                encoder = Encoder.build(spec, arrays, names_of(program), variables)
            except MapStateError:
                if not spec.optional:
                    raise
                continue
            self._encode(topic, encoder)

    def _robot(self, frame_prefix: str) -> None:
        """Record the robot's description and frames."""
        frames = None if self._session is None else self._session.frames
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
        if frames is not None and frames.out is not None:
            frames.out.tap = self._tap(frames.out.topic, frames.out.spec)
        elif messages.links is not None:
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
        every = encoder.spec.every(self._program.period)
        self._due.append((every, encode, self._channel(topic, encoder.spec)))
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
