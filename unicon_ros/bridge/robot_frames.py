"""What rviz shows a robot with: robot_description, /tf of the links, /tf_static.

`RobotMessages` makes them, for recordings too, where nobody may publish them; `RobotFrames`
publishes them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

from unicon_base.arrays import Array
from unicon_base.errors import UniconError
from unicon_core.flow import Block
from unicon_core.models.find import model_of
from unicon_core.models.kinematic_tree import urdf
from unicon_core.models.posed import Footprint
from unicon_core.models.visual_meshes import dressed
from unicon_core.workflow import Program
from unicon_msgs_map import Encoder
from unicon_msgs_map.layout.messages import shared_messages
from unicon_ros import compat
from unicon_ros.bridge.bindings import arrays_of
from unicon_ros.bridge.declare import declare
from unicon_ros.bridge.qos import LATCHED, qos_profile
from unicon_ros.bridge.topics_out import TopicOut
from unicon_ros.bridge.transforms import (
    FOOTPRINT,
    TF_MESSAGE,
    LinkTransforms,
    static_transforms,
    tf_entry,
)
from unicon_ros.parameter_table import FRAMES

RATE = 50.0
"""Rate of the links' transforms in [Hz]: what a viewer needs, whatever the tick."""


class RobotMessages:
    """Of the first robot, where there are many.

    Args:
        program: whose robot it is.
        stamp: `stamp_ns` as it is published, int64 scalar, read in place.
        frame_prefix: stands before the names of all frames; the description goes without, as
            robot_state_publisher's does, since viewers add it (RViz: "TF Prefix").
        links, footprint, description: which of them are wanted.

    Attributes:
        description: the URDF; empty where it is not wanted.
        lacking: meshes that it has not, in one line; empty where all are there.
        reads: the states that /tf is made of.

    Raises:
        UniconError: the robot has no model.
    """

    def __init__(
        self,
        program: Program,
        stamp: Array,
        frame_prefix: str = "",
        links: bool = True,
        footprint: bool = True,
        description: bool = True,
    ) -> None:
        robot, arrays = program.robot, arrays_of(program)
        loaded, tree, self.lacking = dressed(model_of(program.platform, robot), robot)
        self.description = urdf(tree, robot) if description else ""
        shown = tree if links else tree[:1]
        self._poses = LinkTransforms(shown, arrays["joint_pos"])
        self._names = [link.name for link in shown]
        self._stamp, self._prefix = stamp, frame_prefix
        self._footprint: Footprint | None = None
        self.reads: tuple[str, ...] = ("joint_pos", "stamp_ns")
        own = any(link.name == FOOTPRINT for link in tree)
        if footprint and not own and "base_quat" in arrays:
            below = Footprint.of(loaded, robot, arrays["joint_pos"], arrays["base_quat"])
            self._footprint = below
            self.reads = self.reads if below is None else ("base_quat", *self.reads)

    def update(self) -> None:
        """Bring the frames of /tf up to date."""
        if self._poses.moving:
            self._poses.update()
        if self._footprint is not None:
            self._footprint.update()

    @cached_property
    def static(self) -> bytes:
        """The message of /tf_static; empty where no link is fixed to another."""
        fixed = self._poses.fixed
        return static_transforms(fixed, self._names, self._prefix) if fixed else b""

    @cached_property
    def links(self) -> Encoder | None:
        """Of /tf: the moving links and the footprint, after `update`; None where there are none."""
        poses, footprint = self._poses, self._footprint
        if not poses.moving and footprint is None:
            return None
        arrays = {"stamp_ns": self._stamp, "positions": poses.positions, "quats": poses.quats}
        if footprint is not None:
            arrays |= {"footprint_position": footprint.position, "footprint_quat": footprint.quat}
        below = footprint is not None
        spec = tf_entry("/tf", poses.moving, self._names, RATE, self._prefix, below)
        return Encoder.build(spec, arrays)


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
        stamp: Array,
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
