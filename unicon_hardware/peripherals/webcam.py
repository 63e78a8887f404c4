"""Webcam: pictures of a V4L2 device, by a handle and as a topic.

    commands:
      - webcam: {device: /dev/v4l/by-id/usb-046d_C920-video-index0, topic: front/image_raw}

`format: yuyv` gives rgb8 in sensor_msgs/Image, `format: mjpg` the camera's JPEG as it comes, in
sensor_msgs/CompressedImage: larger pictures over USB 2, and nobody decodes what nobody looks at.
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from pathlib import Path
from pkgutil import resolve_name
from typing import Annotated, Any

import numpy as np

from unicon_base import AnyDict, UniconError, alternatives
from unicon_base.arrays import UInt8
from unicon_base.schema.marks import positive
from unicon_core.flow import Block
from unicon_core.states import StateSpec
from unicon_core.workflow.autowire import BuildContext
from unicon_hardware.peripherals.v4l2 import Capture, Frame, Kernel
from unicon_ros.bridge.bindings import checked_prefix
from unicon_ros.bridge.images import (
    CameraTopics,
    FrameMessage,
    Reliability,
    frame_message,
    jpeg_message,
    large_data,
    topic_options,
)
from unicon_ros.peripheral import Count, Stale, peripheral_block, peripheral_states
from unicon_ros.peripheral_process import SLICE, Feed, Gone, end, serve

PROCESS = "unicon_hardware.peripherals.webcam"

FORMATS = {"yuyv": "YUYV", "mjpg": "MJPG"}
"""Words of the option to the letters of V4L2."""


def webcam(
    *,
    context: BuildContext,
    prefix: str = "webcam",
    device: str = "auto",
    format: str = "yuyv",
    width: Count = 640,
    height: Count = 480,
    rate: Annotated[float, positive(unit="Hz")] = 30.0,
    topic: str = "",
    frame_prefix: str = "",
    stale: Stale = 0.3,
    reliability: Reliability = "reliable",
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
        "ros": topic_options(node or name, namespace, ros_args, reliability),
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


def message_of(options: AnyDict) -> FrameMessage:
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


BY_ID = Path("/dev/v4l/by-id")
SILENCE = 2.0
"""A camera that gives nothing for so long is opened anew, in [s]."""

JPEG = b"\xff\xd8"
"""Start of image, which every JPEG begins with (ITU-T T.81, B.1.1.3)."""


class Rgb:
    """Makes rgb8 of YUYV: Y'CbCr of BT.601, a pair of pixels Y0 Cb Y1 Cr (kernel documentation,
    "Packed YUV formats"), its colours from 16 to 235 and 240, or all of 0 to 255.

    Args:
        width: of the pictures, [pixels].
        height: of the pictures, [pixels].
        full: all of 0 to 255 is used.
    """

    def __init__(self, width: int, height: int, full: bool) -> None:
        shape, value = (height, width // 2, 2), np.arange(256)
        lift, luma, chroma = (0, 1.0, 1.0) if full else (16, 255 / 219, 255 / 224)
        # In 1/32: 16 bits hold all sums. The half rounds.
        self._luma = np.round(32 * luma * (value - lift) + 16).astype(np.int16)
        around = 32 * chroma * (value - 128)
        factors = {"r": 1.402, "gr": -0.714136, "gb": -0.344136, "b": 1.772}
        self._chroma = {k: np.round(f * around).astype(np.int16) for k, f in factors.items()}
        self._sum = np.empty(shape, np.int16)

    def __call__(self, packed: UInt8, into: UInt8) -> None:
        """Write the colours of a picture.

        Args:
            packed: shape (height, width / 2, 4).
            into: shape (height, width, 3).
        """
        chroma, total = self._chroma, self._sum
        luma, blue, red = self._luma[packed[..., ::2]], packed[..., 1], packed[..., 3]
        pairs = into.reshape(*total.shape, 3)
        parts = (chroma["r"][red], chroma["gr"][red] + chroma["gb"][blue], chroma["b"][blue])
        for number, part in enumerate(parts):
            np.add(luma, part[..., None], out=total)
            np.right_shift(total, 5, out=total)
            np.clip(total, 0, 255, out=total)
            pairs[..., number] = total


class _Webcam:
    """One camera, streaming."""

    def __init__(self, feed: Feed) -> None:
        options = feed.options
        self._feed, self._size = feed, (options["size"][0], options["size"][1])
        self._message, self._ring = message_of(options), feed.rings[""]
        place = options["system"]
        system = Kernel() if place is None else resolve_name(place)()
        path, self._told = _path(options["path"]), False
        letters, rate = FORMATS[options["format"]], options["rate"]
        self._capture = Capture(system, path, self._size, letters, rate)
        got = self._capture.rate
        if got and abs(got - rate) > 0.05 * rate:
            feed.tell(f"{feed.name}: {self._capture.card} gives {got:g} pictures a second")
        self._rgb: Rgb | None = None
        if options["format"] == "yuyv":
            self._rgb = Rgb(*self._size, self._capture.full)
        if not self._ring.latest:  # else it holds frames of a process that has died
            self._ring.touch(self._message.template)
        self._heard = time.monotonic()
        self._topics: CameraTopics | None = None
        if options["topic"]:
            self._topics = CameraTopics(options["ros"], feed.tell)
            topic = options["topic"] + ("" if self._rgb is not None else "/compressed")
            self._publish = self._topics.add(topic, self._message.type)

    def poll(self) -> None:
        """Take a picture, if one comes."""
        frame, now = self._capture.take(SLICE), time.monotonic()
        if frame is not None and self._is_whole(frame):
            self._heard = now
            self._take(frame)
        elif now - self._heard > SILENCE:
            raise Gone(f"it gave no pictures for {SILENCE:g} s")
        if self._topics is not None:
            self._topics.look()

    def _is_whole(self, frame: Frame) -> bool:
        """Tell whether it is a picture; tell the operator of the first that is not one."""
        (width, height), count = self._size, len(frame.data)
        if self._rgb is not None:
            row = max(self._capture.row, 2 * width)
            wrong = count < row * (height - 1) + 2 * width
            what = f"{count} B, not {row * height}"
        else:
            wrong = bytes(frame.data[:2]) != JPEG or count > self._message.shape[0]
            what = f"{count} B that are not a JPEG"
        if wrong and not self._told:
            self._told = True
            self._feed.tell(f"{self._feed.name}: a picture has {what}; such are left out")
        return not wrong

    def _take(self, frame: Frame) -> None:
        now_ns = time.monotonic_ns()
        taken_ns = frame.monotonic_ns if 0 < now_ns - frame.monotonic_ns < 1e9 else now_ns
        wall_ns = time.time_ns() - (now_ns - taken_ns)
        slot = self._ring.fill()
        if self._rgb is None:
            length = self._message.put(slot, frame.data)
        else:
            width, height = self._size
            row = max(self._capture.row, 2 * width)
            shape, strides = (height, width // 2, 4), (row, 4, 1)
            packed = np.ndarray(shape, np.uint8, frame.data, strides=strides)
            self._rgb(packed, self._message.data(slot))
            length = len(slot)
        self._message.stamp(slot, wall_ns)
        self._ring.commit(wall_ns)
        self._feed.publish(taken_ns)
        if self._topics is not None:
            self._publish(slot[:length].tobytes())

    def close(self) -> None:
        """Let the camera and its topic go."""
        if self._topics is not None:
            self._topics.close()
        self._capture.close()


def _path(given: str) -> str:
    """Return the path of a device.

    Raises:
        Gone: `auto`, and there is none.
    """
    if given != "auto":
        return given if os.sep in given else str(BY_ID / given)
    found = sorted(BY_ID.glob("*-video-index0")) or sorted(Path("/dev").glob("video[0-9]*"))
    if not found:
        raise Gone("no webcam is connected (no /dev/video*)")
    return str(found[0])


if __name__ == "__main__":
    end(serve(_Webcam))
