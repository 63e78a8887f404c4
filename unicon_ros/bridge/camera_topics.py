"""Topics of a simulated camera: its pictures, their CameraInfo, and where its frame is.

The CameraInfo goes to `camera_info` beside the pictures, where image_transport looks for it, with
their stamp and frame. The optical frame is told once, latched, on /tf_static.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.models.camera import ModelCamera
from unicon_core.models.links import Link
from unicon_msgs_map.layout.messages import shared_messages
from unicon_ros import compat
from unicon_ros.bridge.images import INFO, STAMP, FrameMessage, info_message
from unicon_ros.bridge.own_node import OwnNode
from unicon_ros.bridge.qos import LATCHED, qos_profile
from unicon_ros.bridge.transforms import TF_MESSAGE, static_transforms

__all__ = ["CameraTopics"]


class CameraTopics:
    """Publishes; call it with each picture's message.

    Args:
        options: of the camera.
        message: layout of a frame.
        camera: whose pictures they are.

    Raises:
        UniconError: a name or a ROS argument is wrong.
        MissingDependencyError: rclpy is not installed.
    """

    def __init__(self, options: dict[str, Any], message: FrameMessage, camera: ModelCamera) -> None:
        from rclpy.qos import QoSProfile, ReliabilityPolicy

        self._own = OwnNode(options["node"], options["namespace"], options["ros_args"])
        reliability = ReliabilityPolicy[options["reliability"].upper()]
        self._qos = QoSProfile(depth=2, reliability=reliability)
        self._publish, topic = self._publisher(message.type, options["topic"])
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
        message = compat.bytes_class(TF_MESSAGE, shared_messages())
        if message is None:
            return
        links = [Link(parent, -1, at, quat), Link(frame, 0, at, quat)]
        publisher = self._own.node.create_publisher(message, "/tf_static", qos_profile(LATCHED))
        publisher.publish(static_transforms(links[1:], [parent, frame]))

    def __call__(self, message: bytes) -> None:
        self._publish(message)
        if self._publish_info is not None:
            self._info[STAMP] = message[STAMP]
            self._publish_info(bytes(self._info))
