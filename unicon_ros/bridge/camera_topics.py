"""Topics of a camera, simulated or real: images and clouds, their CameraInfo, where its frame is.

The CameraInfo goes to `camera_info` beside the pictures, where image_transport looks for it, with
their stamp and frame. The optical frame is told once, latched, on /tf_static.

Pictures are reliable unless told otherwise: ROS's default subscriber asks for that, and one that
asks for best effort gets them too. A subscriber that stalls keeps nobody waiting: the newest two
pictures are kept for it, older ones are dropped. A subscriber that gets nothing is told about.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from unicon_base.arrays import Float64
from unicon_base.errors import UniconError, alternatives
from unicon_base.resources import find_config, same_modules
from unicon_core.models.kinematic_tree import Link
from unicon_msgs_map.layout.messages import shared_messages
from unicon_msgs_map.spec import Qos
from unicon_ros import compat
from unicon_ros.bridge.images import INFO, STAMP
from unicon_ros.bridge.own_node import PROFILES, OwnNode
from unicon_ros.bridge.qos import LATCHED, QosEvents, qos_profile
from unicon_ros.bridge.robot_frames import TF_MESSAGE, static_transforms

RELIABILITIES = ("reliable", "best_effort")
"""Of a camera's topics; the first is the default."""

DEPTH = 2
"""Pictures that are kept for a reader that is late."""

LOOK = 0.2
"""How often events of the middleware are asked for, in [s]."""


class CameraTopics:
    """A node with the topics of one camera.

    Args:
        options: of `topic_options`.
        tell: takes a line for the operator.

    Raises:
        UniconError: a name or a ROS argument is wrong.
        MissingDependencyError: rclpy is not installed.
    """

    def __init__(self, options: Mapping[str, Any], tell: Callable[[str], None]) -> None:
        self._own = OwnNode(options["node"], options["namespace"], options["ros_args"])
        self._tell, self._due = tell, 0.0
        self._qos = Qos(reliability=options["reliability"], depth=DEPTH)

    def add(self, topic: str, kind: str, info: bytes | None = None) -> Callable[[bytes], None]:
        """Return what publishes messages of one more topic.

        Args:
            topic: its name.
            kind: message type.
            info: CameraInfo that goes beside each message, with its stamp; None for none.
        """
        publish, whole = self._publisher(kind, topic)
        if info is None:
            return publish
        publish_info, _ = self._publisher(INFO, f"{whole.rpartition('/')[0]}/camera_info")
        beside = bytearray(info)

        def both(message: bytes) -> None:
            publish(message)
            beside[STAMP] = message[STAMP]
            publish_info(bytes(beside))

        return both

    def _publisher(self, kind: str, topic: str) -> tuple[Callable[[bytes], None], str]:
        node, message = self._own.node, compat.message_class(kind)
        count = 0
        try:
            name = node.resolve_topic_name(topic)
        except Exception as error:
            raise UniconError(f"topic {topic!r}: {error}".splitlines()[0]) from error

        def theirs(policy: str) -> str:
            ours = getattr(self._qos, policy, None)
            peers = [each.qos_profile for each in node.get_subscriptions_info_by_topic(name)]
            found = [getattr(getattr(each, policy, None), "name", "").lower() for each in peers]
            others = dict.fromkeys(value for value in found if value not in ("", ours))
            return f"theirs: {' and '.join(others)}" if others else ""

        remedy = "set {policy} of the camera, or the peer's"
        if self._qos.reliability == RELIABILITIES[0]:
            remedy = "set the peer's {policy}"
        events = QosEvents(
            name, self._qos, "publisher", lambda: count, self._tell, remedy=remedy, theirs=theirs
        )
        profile = qos_profile(self._qos)
        publisher = events.watch(
            lambda **options: node.create_publisher(message, topic, profile, **options)
        )
        send, _ = compat.raw_publish(publisher)

        def publish(data: bytes) -> None:
            nonlocal count
            send(data)
            count += 1

        return publish, name

    def tell_frame(self, frame: str, parent: str, at: Float64, quat: Float64) -> None:
        """Tell where a frame is, once and for late joiners.

        Args:
            frame: the camera's optical one.
            parent: that it stands in.
            at: position in the parent, [m], shape (3,).
            quat: orientation in the parent, wxyz, shape (4,).
        """
        message = compat.bytes_class(TF_MESSAGE, shared_messages())
        if message is None:
            return
        links = [Link(parent, -1, at, quat), Link(frame, 0, at, quat)]
        publisher = self._own.node.create_publisher(message, "/tf_static", qos_profile(LATCHED))
        publisher.publish(static_transforms(links[1:], [parent, frame]))

    def look(self) -> None:
        """Hear, now and then, what the middleware has seen, such as peers that get nothing."""
        now = time.monotonic()
        if now >= self._due:
            self._due = now + LOOK
            self._own.executor.spin_once(timeout_sec=0.0)

    def close(self) -> None:
        """Let the node go."""
        self._own.close()


def topic_options(
    what: str, node: str, namespace: str | None, ros_args: Sequence[str], reliability: str
) -> dict[str, Any]:
    """Return the options of a camera's topics, as `CameraTopics` takes them.

    Args:
        what: the camera, for messages.
        node: name of the process's node.
        namespace: of that node.
        ros_args: ROS arguments of that node, such as remaps.
        reliability: one of RELIABILITIES.

    Raises:
        UniconError: an unknown reliability.
    """
    if reliability not in RELIABILITIES:
        choices = alternatives(reliability, RELIABILITIES)
        raise UniconError(f"{what}: reliability {reliability!r}; {choices}")
    return {
        "node": node,
        "namespace": namespace,
        "ros_args": list(ros_args),
        "reliability": reliability,
    }


def large_data() -> dict[str, str]:
    """Return the environment of a process that publishes images: ours, with room for them."""
    environment = same_modules()
    guard, libraries = "_ROS_WHEELS_BOOTSTRAP_COMPLETE", "LD_LIBRARY_PATH"
    ours = str(Path(sys.prefix, "lib")) in environment.get(libraries, "").split(os.pathsep)
    if guard in environment and not ours:  # the ROS wheels of another venv have set both
        del environment[guard]
        environment.pop(libraries, None)
    profile = str(find_config("dds", "large_data", ".xml"))
    for variable in PROFILES:
        if environment.get(variable, "").endswith("fast_discovery.xml"):
            environment[variable] = profile  # which has fast discovery too
        environment.setdefault(variable, profile)
    return environment
