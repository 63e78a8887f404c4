"""Topics of a simulated camera: its pictures, their CameraInfo, and where its frame is.

The CameraInfo goes to `camera_info` beside the pictures, where image_transport looks for it, with
their stamp and frame. The optical frame is told once, latched, on /tf_static.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from unicon_core.models.camera import Intrinsics
from unicon_core.models.links import Link
from unicon_msgs_map import Encoder, Messages, parse_map
from unicon_ros import compat
from unicon_ros.bridge.images import INFO, STAMP, FrameMessage, info_message
from unicon_ros.bridge.own_node import OwnNode
from unicon_ros.bridge.qos import LATCHED, qos_profile
from unicon_ros.bridge.transforms import tf_map

__all__ = ["CameraTopics", "Shot"]


class Shot(Protocol):
    """What is published of a camera; see `camera_process`."""

    message: FrameMessage
    pinhole: Intrinsics
    mount: tuple[str, NDArray[np.float64], NDArray[np.float64]] | None


class CameraTopics:
    """Publishes; call it with each picture's message.

    Args:
        options: of the camera.
        camera: what the options led to.

    Raises:
        UniconError: a name or a ROS argument is wrong.
        MissingDependencyError: rclpy is not installed.
    """

    def __init__(self, options: dict[str, Any], camera: Shot) -> None:
        from rclpy.qos import QoSProfile, ReliabilityPolicy

        self._own = OwnNode(options["node"], options["namespace"], options["ros_args"])
        reliability = ReliabilityPolicy[options["reliability"].upper()]
        self._qos = QoSProfile(depth=2, reliability=reliability)
        self._publish, topic = self._publisher(camera.message.type, options["topic"])
        self._publish_info: Callable[[bytes], object] | None = None
        if options["kind"] != "cloud":
            beside = f"{topic.rpartition('/')[0]}/camera_info"
            self._publish_info, _ = self._publisher(INFO, beside)
            size = options["width"], options["height"]
            self._info = bytearray(info_message(*size, options["frame_id"], camera.pinhole))
        if camera.mount is not None:
            parent, at, quat = camera.mount
            self._tell_frame(options["frame_id"], options["frame_prefix"] + parent, at, quat)

    def _publisher(self, kind: str, topic: str) -> tuple[Callable[[bytes], object], str]:
        message = compat.message_class(kind)
        publisher = self._own.node.create_publisher(message, topic, self._qos)
        return compat.raw_publish(publisher)[0], publisher.topic_name

    def _tell_frame(
        self, frame: str, parent: str, at: NDArray[np.float64], quat: NDArray[np.float64]
    ) -> None:
        message = compat.message_class("tf2_msgs/msg/TFMessage")
        if message is None:
            return
        links = [Link(parent, -1, at, quat), Link(frame, 0, at, quat)]
        text = tf_map("/tf_static", links[1:], [link.name for link in links], None)
        spec = parse_map(text, Messages(), name="/tf_static").publish[0]
        arrays = {"stamp_ns": np.zeros((), np.int64), "positions": at, "quats": quat}
        publisher = self._own.node.create_publisher(message, spec.topic, qos_profile(LATCHED))
        publisher.publish(Encoder.build(spec, arrays).encode())

    def __call__(self, message: bytes) -> None:
        self._publish(message)
        if self._publish_info is not None:
            self._info[STAMP] = message[STAMP]
            self._publish_info(bytes(self._info))
