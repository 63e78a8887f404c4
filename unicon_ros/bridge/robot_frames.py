"""What rviz shows a robot with: robot_description, /tf of the links, /tf_static, contacts.

`RobotMessages` makes them, for recordings too, which publish nothing; `RobotFrames` publishes them.
The pose of a link is its joint's fixed pose and one turn about (or shift along) the joint's axis,
so all moving links are one vectorized half-angle formula, 8 µs for 29 joints.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cached_property
from typing import Any

import numpy as np

from unicon_base import ModelError, TextSink, UniconError
from unicon_base.arrays import Array, Float32
from unicon_core.flow import Block
from unicon_core.models.feet import Feet
from unicon_core.models.find import model_of
from unicon_core.models.kinematic_tree import Link, urdf
from unicon_core.models.loaded import multiply, rotate
from unicon_core.models.posed import Footprint
from unicon_core.models.visual_meshes import dressed
from unicon_core.platforms.kit.base import rotation
from unicon_core.workflow import Program
from unicon_msgs_map import Encoder, FieldSpec, PublishSpec, Qos
from unicon_msgs_map.layout.messages import shared_messages
from unicon_msgs_map.layout.paths import parse_path, parse_reference
from unicon_ros import compat
from unicon_ros.bridge.bindings import arrays_of, robot_variables
from unicon_ros.bridge.qos import LATCHED, qos_profile
from unicon_ros.bridge.topics import TopicOut
from unicon_ros.parameter_table import FRAMES, declare

TF_MESSAGE = "tf2_msgs/msg/TFMessage"
FOOTPRINT = "base_footprint"


class LinkTransforms:
    """Poses of the moving links, one row each.

    Args:
        links: the tree.
        joint_pos: positions in the robot's order in [rad] or [m], shape (n,), read in place.

    Attributes:
        moving: the links that `positions` and `quats` are of: those of the robot's joints.
        fixed: all others but the root; their joints, if any, are taken at position 0.
        positions: link in its parent's frame in [m], shape (m, 3).
        quats: link to parent, wxyz, shape (m, 4).
    """

    def __init__(self, links: Sequence[Link], joint_pos: Float32) -> None:
        self.moving = [link for link in links if link.index >= 0]
        self.fixed = [link for link in links if link.index < 0 and link.parent >= 0]
        self._joint_pos = joint_pos
        self._index = np.array([link.index for link in self.moving], np.intp)
        self._origin = np.array([link.position for link in self.moving]).reshape(-1, 3)
        self.positions = self._origin.copy()
        self.quats = np.array([link.quat for link in self.moving]).reshape(-1, 4)
        axes = np.array([link.axis for link in self.moving]).reshape(-1, 3)
        # q0 (1, 0) and q0 (0, axis): the turned quaternion is cos(a/2) and sin(a/2) times these.
        self._cos = self.quats.copy()
        self._sin = multiply(self.quats, np.concatenate((np.zeros((len(axes), 1)), axes), axis=1))
        self._slides = [
            (row, rotate(link.quat, link.axis))
            for row, link in enumerate(self.moving)
            if link.sliding
        ]
        self._turning = np.array([0.0 if link.sliding else 0.5 for link in self.moving])

    def update(self) -> None:
        """Bring `positions` and `quats` up to date."""
        joint_pos = self._joint_pos[self._index].astype(np.float64)
        half = joint_pos * self._turning
        np.multiply(self._cos, np.cos(half)[:, None], out=self.quats)
        self.quats += self._sin * np.sin(half)[:, None]
        for row, direction in self._slides:
            self.positions[row] = self._origin[row] + joint_pos[row] * direction


def tf_entry(
    topic: str,
    links: Sequence[Link],
    names: Sequence[str],
    rate: float | None = None,
    prefix: str = "",
    footprint: bool = False,
) -> PublishSpec:
    """Return the entry of a message map for a topic that carries all these links.

    The arrays that it reads are `stamp_ns`, `positions` and `quats`, one row for each link.

    Args:
        topic: `/tf` or `/tf_static`.
        links: whose transforms are carried.
        names: names of all links, by number.
        rate: in [Hz], None for every tick.
        prefix: stands before all names.
        footprint: `base_footprint` too, below the root; read are `footprint_position` and
            `footprint_quat` then.
    """
    rows = [
        (names[e.parent], e.name, f"positions[{3 * i}:{3 * i + 3}]", f"quats[{4 * i}:{4 * i + 4}]")
        for i, e in enumerate(links)
    ]
    if footprint:
        rows.append((names[0], FOOTPRINT, "footprint_position", "footprint_quat"))
    fields: list[FieldSpec] = []
    for i, (parent, child, position, quat) in enumerate(rows):
        fields += _element(
            f"transforms[{i}]",
            {
                "header.stamp": "stamp_ns",
                "header.frame_id": f"={prefix}{parent}",
                "child_frame_id": f"={prefix}{child}",
                "transform.translation": position,
                "transform.rotation": quat,
            },
        )
    types, qos = shared_messages(), Qos(depth=1)
    return PublishSpec(topic, TF_MESSAGE, tuple(fields), types, rate, qos, where=topic)


def _element(place: str, values: Mapping[str, object]) -> Iterator[FieldSpec]:
    for path, value in values.items():
        whole = f"{place}.{path}"
        yield FieldSpec(whole, parse_path(whole), parse_reference(value), where=place)


def static_transforms(links: Sequence[Link], names: Sequence[str], prefix: str = "") -> bytes:
    """Return the message of /tf_static that carries all these links; arguments as of `tf_entry`."""
    arrays = {
        "stamp_ns": np.zeros((), np.int64),
        "positions": np.array([link.position for link in links]),
        "quats": np.array([link.quat for link in links]),
    }
    return Encoder.build(tf_entry("/tf_static", links, names, prefix=prefix), arrays).encode()


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
        loaded: the model.
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
        self.loaded = loaded
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


MARKERS = "visualization_msgs/msg/MarkerArray"
MARKED = "base_quat", "base_ang_vel", "joint_pos", "joint_vel", "joint_effort"
"""States that the forces of the feet follow from."""
MARKER_RATE = 20.0
"""Of the contacts in [Hz]."""
_BEARS = 0.4  # of an equal share of the weight; a leg that swings seems to bear up to a third


class ContactArrows:
    """An arrow for each foot that bears, from its lowest point up; 1 m is the robot's weight.

    The force is an estimate from the measured torques of the leg, see `Feet`: it is the same in
    every simulator and on a robot. A foot that swings, and all of them while a measurement is
    missing, have an arrow that is not visible (alpha 0).

    Args:
        feet: of the robot.
        arrays: what is published by the name of the state, read in place; `MARKED`, `stamp_ns`.
        frame: of the base.

    Attributes:
        encoder: of a MarkerArray, one arrow for each foot, after `update`.
    """

    def __init__(self, feet: Feet, arrays: Mapping[str, Array], frame: str) -> None:
        self._feet, self._given = feet, [arrays[name] for name in MARKED]
        self._ends, self._seen = np.zeros((len(feet.names), 2, 3)), np.zeros(len(feet.names))
        fields: list[FieldSpec] = []
        for i, foot in enumerate(feet.names):
            look = {"ns": f"={foot}", "scale.x": 0.015, "scale.y": 0.03, "color.g": 0.8}  # [m]
            fields += _element(
                f"markers[{i}]",
                {
                    "header.stamp": "stamp_ns",
                    "header.frame_id": f"={frame}",
                    **look,
                    "color.a": f"seen[{i}]",
                    "points[0]": f"ends[{6 * i}:{6 * i + 3}]",
                    "points[1]": f"ends[{6 * i + 3}:{6 * i + 6}]",
                },
            )
        spec = PublishSpec("contacts", MARKERS, tuple(fields), shared_messages(), MARKER_RATE)
        own = {"ends": self._ends, "seen": self._seen, "stamp_ns": arrays["stamp_ns"]}
        self.encoder = Encoder.build(spec, own)

    def update(self) -> None:
        """Bring the arrows up to date, in the frame of the base."""
        feet, ends = self._feet, self._ends
        self._seen[:] = feet(*self._given) and feet.force > _BEARS * feet.weight / len(ends)
        if self._seen.any():
            ends[:] = feet.position[:, None]
            ends[:, 1, 2] += feet.force / feet.weight
            ends[:] = ends @ rotation(self._given[0])


class RobotFrames:
    """Publishes `robot_description` and `/tf_static`, latched for late joiners, /tf and contacts.

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
        outs: the topics /tf and `contacts`, where the robot has feet and torques are measured.
        blocks: publish those when they are due; `contacts` only while it has subscribers.
    """

    def __init__(
        self,
        node: Any,
        program: Program,
        stamp: Array,
        group: Any,
        warn: TextSink,
        frame_prefix: str = "",
    ) -> None:
        self.messages: RobotMessages | None = None
        self.outs, self.blocks = list[TopicOut](), list[Block]()
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
        made = [(messages.links, messages.update, messages.reads)]
        arrays = {**arrays_of(program), "stamp_ns": stamp}
        if arrays.keys() >= {*MARKED}:
            with suppress(ModelError):  # it has no feet
                feet = Feet(messages.loaded, program.robot)
                frame = robot_variables(program.robot, frame_prefix)["base_frame"]
                arrows = ContactArrows(feet, arrays, str(frame))
                made.append((arrows.encoder, arrows.update, MARKED))
        for encoder, update, reads in made:
            if encoder is None:
                continue
            spec = encoder.spec
            message = compat.bytes_class(spec.type, shared_messages())
            if message is None:
                warn(f"topic {spec.topic} is left out: type {spec.type} is not installed")
                continue
            every = spec.every(program.period)
            args = node, encoder, message, every, every - 1, group, warn, update, "links"
            out = TopicOut(*args, lazy=encoder is not messages.links)
            self.outs.append(out)
            self.blocks.append(Block(f"publish {spec.topic} (links)", out.tick, reads=reads))

    def _latch(self, topic: str, kind: str, content: str | bytes) -> None:
        message = compat.bytes_class(kind, shared_messages())
        if message is None:
            self._warn(f"topic {topic} is left out: type {kind} is not installed")
            return
        publisher = self._node.create_publisher(message, topic, qos_profile(LATCHED))
        publisher.publish(message(data=content) if isinstance(content, str) else content)
        self._latched.append(publisher)

    def close(self) -> None:
        """Destroy the latched publishers; `outs` are closed with the other topics."""
        for publisher in self._latched:
            self._node.destroy_publisher(publisher)
        self._latched = []
