"""Webcam: pictures of a V4L2 device, by a handle and as a topic.

    commands:
      - webcam: {device: /dev/v4l/by-id/usb-046d_C920-video-index0, topic: front/image_raw}

`format: yuyv` gives rgb8 in sensor_msgs/Image, `format: mjpg` the camera's JPEG as it comes, in
sensor_msgs/CompressedImage: larger pictures over USB 2, and nobody decodes what nobody looks at.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from unicon_core.errors import UniconError, alternatives
from unicon_core.flow import Block
from unicon_core.states import StateSpec
from unicon_core.workflow.autowire import BuildContext
from unicon_ros.bridge.bindings import checked_prefix
from unicon_ros.bridge.camera_topics import RELIABILITIES, large_data, topic_options
from unicon_ros.bridge.images import FrameMessage, frame_message, jpeg_message
from unicon_ros.peripherals.peripheral import (
    check_positive,
    peripheral_block,
    peripheral_states,
)

PROCESS = "unicon_ros.peripherals.webcam_process"

FORMATS = {"yuyv": "YUYV", "mjpg": "MJPG"}
"""Words of the option to the letters of V4L2."""


def webcam(
    *,
    context: BuildContext,
    prefix: str = "webcam",
    device: str = "auto",
    format: str = "yuyv",
    width: int = 640,
    height: int = 480,
    rate: float = 30.0,
    topic: str = "",
    frame_prefix: str = "",
    stale: float = 0.3,
    reliability: str = RELIABILITIES[0],
    node: str = "",
    namespace: str | None = None,
    ros_args: Sequence[str] = (),
    system: str | None = None,
) -> Block:
    """Take pictures of a webcam; its handle is 0 while it is not there.

    Args:
        context: of the workflow.
        prefix: stands before the names of its states, its frame and its node.
        device: such as /dev/video0, or a name of /dev/v4l/by-id, which stays with the camera; auto
            takes the first camera.
        format: `yuyv` or `mjpg`.
        width: of the pictures, [pixels].
        height: of the pictures, [pixels].
        rate: pictures per second.
        topic: name; pictures of mjpg go to `compressed` below it. Empty to publish nothing.
        frame_prefix: stands before the name of its frame; that of the robot's node.
        stale: so long no picture may come, in [s].
        reliability: of the topic: `reliable`, which all subscribers get, or `best_effort`.
        node: name of the process's node; the peripheral's if empty.
        namespace: of that node.
        ros_args: ROS arguments of that node, such as remaps.
        system: `module:function` that returns what is asked in place of Linux, for tests.

    Raises:
        UniconError: an option is wrong, or the device has no such pictures.
        MissingDependencyError: rclpy is not installed, and there is a topic.
    """
    name = prefix
    check_positive(name, width=width, height=height, rate=rate)
    if format not in FORMATS:
        raise UniconError(f"{name}: format {format!r}; {alternatives(format, FORMATS)}")
    if format == "yuyv" and width % 2:
        raise UniconError(
            f"{name}: width is {width}; yuyv has two pixels in a word, give an even one"
        )
    options = {
        "path": device,
        "format": format,
        "size": [int(width), int(height)],
        "rate": float(rate),
        "topic": topic,
        "frame_id": f"{checked_prefix(frame_prefix)}{name}_optical_frame",
        "ros": topic_options(name, node or name, namespace, ros_args, reliability),
        "system": system,
    }
    return peripheral_block(
        context,
        name,
        PROCESS,
        options,
        values=(),
        frames={"": message_of(options)},
        stale=stale,
        environment=large_data(),
    )


def message_of(options: dict[str, Any]) -> FrameMessage:
    """Return the layout of its frames.

    Args:
        options: of the peripheral, as its process gets them.
    """
    width, height = options["size"]
    if options["format"] == "mjpg":  # no driver's pictures are larger than raw ones
        return jpeg_message(2 * width * height, options["frame_id"])
    return frame_message("color", width, height, options["frame_id"])


def _declares(*, prefix: str = "webcam", **_: Any) -> dict[str, StateSpec]:
    return peripheral_states(prefix, {}, [""])


webcam.declares = _declares  # type: ignore[attr-defined]
