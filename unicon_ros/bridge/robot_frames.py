"""RobotFrames: what rviz shows a robot with: robot_description, /tf of the links, /tf_static."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numpy.typing import NDArray

from unicon_core.errors import UniconError
from unicon_core.flow import Block
from unicon_core.workflow import Program
from unicon_msgs_map.layout.messages import shared_messages
from unicon_ros import compat
from unicon_ros.bridge.declare import declare
from unicon_ros.bridge.qos import LATCHED, qos_profile
from unicon_ros.bridge.robot_messages import RobotMessages
from unicon_ros.bridge.topics_out import TopicOut
from unicon_ros.bridge.transforms import TF_MESSAGE
from unicon_ros.parameter_table import FRAMES


class RobotFrames:
    """Publishes `robot_description` and `/tf_static` once, latched for late joiners, and `/tf`.

    The node's parameters `publish_link_tf`, `publish_base_footprint` and
    `publish_robot_description` switch each of them off, for a robot_state_publisher instead of us.

    A robot without a model goes without, and without frames where neither tf2_msgs is installed
    nor its type can be made (`compat.bytes_class`); with one notice each.

    Args:
        node: rclpy node.
        program: whose robot it is.
        stamp: `stamp_ns` as it is published, int64 scalar, read in place.
        group: callback group of the publishers' events.
        warn: takes notices.
        frame_prefix: stands before the names of all frames, see `RobotMessages`.

    Attributes:
        messages: what is published; None where there is no model, or nothing is wanted.
        out: the topic /tf; None where there is none.
        block: publishes /tf when it is due.
    """

    def __init__(
        self,
        node: Any,
        program: Program,
        stamp: NDArray[Any],
        group: Any,
        warn: Callable[[str], None],
        frame_prefix: str = "",
    ) -> None:
        self.messages: RobotMessages | None = None
        self.out: TopicOut | None = None
        self.block = Block("publish /tf", lambda: None)
        self._node, self._warn = node, warn
        self._latched: list[Any] = []
        declare(node, FRAMES)
        wanted = [node.get_parameter(name).value for name, *_ in FRAMES]
        if not any(wanted):
            return
        try:
            messages = self.messages = RobotMessages(program, stamp, frame_prefix, *wanted)
        except UniconError as error:
            warn(f"no robot_description and no frames of the links: {error}")
            return
        if messages.description:
            if messages.lacking:
                warn(f"robot_description shows primitives or less: {messages.lacking}")
            self._latch("robot_description", "std_msgs/msg/String", messages.description)
        if messages.static:
            self._latch("/tf_static", TF_MESSAGE, messages.static)
        if messages.links is None:
            return
        message = compat.bytes_class(TF_MESSAGE, shared_messages())
        if message is None:
            warn(f"topic /tf is left out: type {TF_MESSAGE} is not installed")
            return
        every = messages.links.spec.every(program.period)
        phase, update = every - 1, messages.update
        self.out = TopicOut(
            node, messages.links, message, every, phase, group, warn, update, part="links"
        )
        self.block = Block("publish /tf (links)", self.out.tick, reads=messages.reads)

    def _latch(self, topic: str, kind: str, content: str | bytes) -> None:
        message = compat.bytes_class(kind, shared_messages())
        if message is None:
            self._warn(f"topic {topic} is left out: type {kind} is not installed")
            return
        publisher = self._node.create_publisher(message, topic, qos_profile(LATCHED))
        publisher.publish(message(data=content) if isinstance(content, str) else content)
        self._latched.append(publisher)

    def close(self) -> None:
        """Destroy the latched publishers; `out` is closed with the other topics."""
        for publisher in self._latched:
            self._node.destroy_publisher(publisher)
        self._latched = []
