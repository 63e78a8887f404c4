"""RobotFrames: what rviz shows a robot with: robot_description, /tf of the links, /tf_static."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numpy.typing import NDArray

from unicon_core.errors import UniconError
from unicon_core.flow import Block
from unicon_core.models.find import model_of
from unicon_core.models.footprint import Footprint
from unicon_core.models.kinematic_tree import read_tree
from unicon_core.models.links import Link
from unicon_core.models.load import load_model
from unicon_core.models.urdf_write import urdf
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

__all__ = ["RobotFrames"]

RATE = 50.0
"""Rate of the links' transforms in [Hz]: what a viewer needs, whatever the tick."""


class RobotFrames:
    """Publishes `robot_description` and `/tf_static` once, latched for late joiners, and `/tf`.

    The node's parameters `publish_link_tf`, `publish_base_footprint` and
    `publish_robot_description` switch each of them off, for a robot_state_publisher instead of us.

    A robot without a model goes without, and without frames where neither tf2_msgs is installed
    nor its type can be made (`compat.bytes_class`); with one notice each.

    Args:
        node: rclpy node.
        workflow: whose robot it is.
        stamp: `stamp_ns` as it is published, int64 scalar, read in place.
        group: callback group of the publishers' events.
        warn: takes notices.
        frame_prefix: stands before the names of all frames; robot_description goes without, as
            robot_state_publisher's does, since viewers add it (RViz: "TF Prefix").

    Attributes:
        description: the URDF; empty where there is none.
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
        self._prefix = frame_prefix
        self.description = ""
        self.out: TopicOut | None = None
        self.block = Block("publish /tf", lambda: None)
        self._node, self._group, self._warn = node, group, warn
        self._latched: list[Any] = []
        declare(node, FRAMES)
        links, footprint, description = (node.get_parameter(name).value for name, *_ in FRAMES)
        if not (links or footprint or description):
            return
        robot = program.robot
        try:
            loaded = load_model(model_of(program.platform, robot), robot, quiet=True)
            tree = read_tree(loaded.model, robot)
        except UniconError as error:
            warn(f"no robot_description and no frames of the links: {error}")
            return
        if description:
            self.description = urdf(tree, robot)
            self._latch("robot_description", "std_msgs/msg/String", self.description)
        below = None
        arrays = arrays_of(program)
        own = any(link.name == FOOTPRINT for link in tree)
        if footprint and not own and "base_quat" in arrays:
            below = Footprint.of(loaded, robot, arrays["joint_pos"], arrays["base_quat"])
        if links or below is not None:
            self._publish_frames(program, tree if links else tree[:1], below, stamp)

    def _latch(self, topic: str, kind: str, content: str | bytes) -> None:
        message = compat.bytes_class(kind, shared_messages())
        if message is None:
            self._warn(f"topic {topic} is left out: type {kind} is not installed")
            return
        publisher = self._node.create_publisher(message, topic, qos_profile(LATCHED))
        publisher.publish(message(data=content) if isinstance(content, str) else content)
        self._latched.append(publisher)

    def _publish_frames(
        self,
        program: Program,
        links: list[Link],
        footprint: Footprint | None,
        stamp: NDArray[Any],
    ) -> None:
        poses = LinkTransforms(links, arrays_of(program)["joint_pos"])
        names = [link.name for link in links]
        if poses.fixed:
            static = static_transforms(poses.fixed, names, self._prefix)
            self._latch("/tf_static", TF_MESSAGE, static)
        if not poses.moving and footprint is None:
            return
        arrays = {"stamp_ns": stamp, "positions": poses.positions, "quats": poses.quats}
        updates = [poses.update] if poses.moving else []
        reads: tuple[str, ...] = ("joint_pos", "stamp_ns")
        if footprint is not None:
            arrays |= {"footprint_position": footprint.position, "footprint_quat": footprint.quat}
            updates.append(footprint.update)
            reads = ("base_quat", *reads)
        spec = tf_entry("/tf", poses.moving, names, RATE, self._prefix, footprint is not None)
        encoder = Encoder.build(spec, arrays)
        every = spec.every(program.period)
        message = compat.bytes_class(spec.type, spec.messages)
        if message is None:
            self._warn(f"topic {spec.topic} is left out: type {spec.type} is not installed")
            return

        def update() -> None:
            for each in updates:
                each()

        out = TopicOut(
            self._node,
            encoder,
            message,
            every,
            every - 1,
            self._group,
            self._warn,
            update,
            part="links",
        )
        self.out = out
        self.block = Block("publish /tf (links)", out.tick, reads=reads)

    def close(self) -> None:
        """Destroy the latched publishers; `out` is closed with the other topics."""
        for publisher in self._latched:
            self._node.destroy_publisher(publisher)
        self._latched = []
