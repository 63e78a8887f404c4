"""Images and clouds as messages, and the topics of a camera, simulated or real.

The layouts are those of sensor_msgs/Image, PointCloud2 and CameraInfo in little-endian CDR: bytes
laid out once, so that a frame is rendered into its place. The CameraInfo goes to `camera_info`
beside the pictures, where image_transport looks for it, with their stamp and frame. The optical
frame is published once, latched, on /tf_static.

Pictures are reliable unless an option says otherwise: ROS's default subscriber asks for that, and
one that asks for best effort gets them too. A subscriber that stalls delays no tick: the newest two
pictures are kept for it, older ones are dropped. A subscriber that gets nothing is reported.
"""

from __future__ import annotations

import math
import os
import struct
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from unicon_base import AnyDict, AnyMapping, TextSink, UniconError, alternatives, imported
from unicon_base.arrays import Array, Float32, Float64
from unicon_base.resources import find_config, same_modules
from unicon_core.models.camera import Intrinsics
from unicon_core.models.kinematic_tree import Link
from unicon_msgs_map import Encoder, FieldSpec, PublishSpec, Qos
from unicon_msgs_map.layout.messages import shared_messages
from unicon_msgs_map.layout.paths import Reference, parse_path
from unicon_ros import compat
from unicon_ros.bridge.own_node import PROFILES, OwnNode
from unicon_ros.bridge.qos import LATCHED, QosEvents, qos_profile
from unicon_ros.bridge.robot_frames import TF_MESSAGE, static_transforms

IMAGE, CLOUD = "sensor_msgs/msg/Image", "sensor_msgs/msg/PointCloud2"
INFO, JPEG = "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/CompressedImage"
KINDS = ("color", "depth", "cloud")
"""`color` rgb8; `depth` 32FC1 in [m] along the view axis (REP-118); `cloud` x, y, z in [m]."""

# NumPy's name of a type to that of PointField.
_FIELDS = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
STAMP = slice(4, 12)
"""Where the header's stamp stands in all these messages: behind the encapsulation header."""


@dataclass(frozen=True)
class FrameMessage:
    """The layout of one message.

    Attributes:
        type: message type.
        template: all bytes, with zeros for stamp and data.
        offset: where the data begin, [B].
        shape: of the data: (height, width, 3), (height, width), or (width,) points.
        dtype: of the data.
        frame_id: of the header.
    """

    type: str
    template: bytes
    offset: int
    shape: tuple[int, ...]
    dtype: str | np.dtype[np.void]
    frame_id: str = ""

    def data(self, buffer: Any) -> Array:
        """Return the view of the data in a message's buffer; to write into or to read."""
        view: Array = np.ndarray(self.shape, self.dtype, buffer, self.offset)
        return view

    def put(self, buffer: Any, data: memoryview) -> int:
        """Write data of any length, and how long they are; return the message's length, [B].

        Args:
            buffer: of a message.
            data: at most as many bytes as `shape` says.
        """
        count = len(data)
        struct.pack_into("<I", buffer, self.offset - 4, count)
        memoryview(buffer)[self.offset : self.offset + count] = data
        return self.offset + count

    def stamp(self, buffer: Any, stamp_ns: int) -> None:
        """Write the header's stamp, [ns]."""
        struct.pack_into("<iI", buffer, STAMP.start, *divmod(stamp_ns, 1_000_000_000))


def frame_message(kind: str, width: int, height: int, frame_id: str) -> FrameMessage:
    """Return the layout of a kind of frame.

    Args:
        kind: one of KINDS.
        width: in pixels.
        height: in pixels.
        frame_id: of the header; an optical frame (z forward, x right, y down; REP-103).

    Raises:
        UniconError: an unknown kind.
    """
    if kind not in KINDS:
        raise UniconError(f"camera kind {kind!r}; {alternatives(kind, KINDS)}")
    shape = (height, width) if kind == "depth" else (height, width, 3)
    dtype = "|u1" if kind == "color" else "<f4"
    row = np.dtype(dtype).itemsize * math.prod(shape[1:])
    given: AnyDict = {"height": height, "width": width}
    if kind == "cloud":
        given |= _point_fields([("x", 0, "f4"), ("y", 4, "f4"), ("z", 8, "f4")])
        given |= {"point_step": 12, "row_step": row}
        return _with_data(CLOUD, given, row * height, shape, dtype, frame_id)
    given |= {"encoding": "rgb8" if kind == "color" else "32FC1", "step": row}
    return _with_data(IMAGE, given, row * height, shape, dtype, frame_id)


def cloud_message(width: int, point: np.dtype[np.void], frame_id: str) -> FrameMessage:
    """Return the layout of a cloud of points in no order (height 1).

    Args:
        width: number of points; those that are not there are to be NaN.
        point: what a point is: named fields, little endian.
        frame_id: of the header.
    """
    assert point.fields is not None
    fields = ((name, at, kind.str[1:]) for name, (kind, at, *_) in point.fields.items())
    size = point.itemsize * width
    given = _point_fields(sorted(fields, key=lambda field: field[1]))
    given |= {"height": 1, "width": width, "row_step": size, "point_step": point.itemsize}
    return _with_data(CLOUD, given, size, (width,), point, frame_id)


def jpeg_message(most: int, frame_id: str) -> FrameMessage:
    """Return the layout of a CompressedImage with a JPEG; `put` writes it and tells its length.

    Args:
        most: largest size of the JPEG, [B].
        frame_id: of the header, an optical frame.
    """
    empty = _message(JPEG, {"header.frame_id": frame_id, "format": "jpeg"})
    return FrameMessage(JPEG, empty + bytes(most), len(empty), (most,), "|u1", frame_id)


def as_jpeg(pixels: Any, shape: Sequence[int], quality: int) -> bytes:
    """Return the JPEG of a picture; into a file, Pillow makes it without Python's lock.

    Args:
        pixels: rgb8, a buffer.
        shape: (height, width, 3).
        quality: 1 to 100.

    Raises:
        MissingDependencyError: Pillow is not installed.
    """
    image = imported("PIL.Image", "pictures as JPEG", "webxr", "pillow")
    picture = image.frombuffer("RGB", (shape[1], shape[0]), pixels, "raw", "RGB", 0, 1)
    with os.fdopen(os.memfd_create("jpeg"), "r+b") as file:
        picture.save(file, "JPEG", quality=quality)
        file.seek(0)
        return file.read()


def info_message(
    width: int,
    height: int,
    frame_id: str,
    pinhole: Intrinsics,
    distortion: Sequence[float] = (0.0,) * 5,
) -> bytes:
    """Return a CameraInfo with stamp 0, for an image as `frame_message` lays it out.

    Nothing is turned (R the identity, P as K), and binning and region are left at 0, which stands
    for the whole image (REP-104). All of K is 0 where the camera is not a pinhole: that is how the
    message says "not calibrated".

    Args:
        width: in pixels.
        height: in pixels.
        frame_id: that of the image.
        pinhole: of the whole image.
        distortion: k1, k2, p1, p2, k3 of the model `plumb_bob`.
    """
    fx, fy, cx, cy = pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy
    known = float(fx > 0.0)
    given = {"header.frame_id": frame_id, "height": height, "width": width}
    matrices = {
        "d": [*distortion],
        "k": [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, known],
        "r": [known, 0.0, 0.0, 0.0, known, 0.0, 0.0, 0.0, known],
        "p": [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, known, 0.0],
    }
    return _message(INFO, given | {"distortion_model": "plumb_bob"} | matrices)


def rays(width: int, height: int, pinhole: Intrinsics) -> Float32:
    """Return x, y, z per metre of depth of each pixel, optical frame, shape (height, width, 3).

    Args:
        width: in pixels.
        height: in pixels.
        pinhole: of the image.
    """
    found = np.ones((height, width, 3), np.float32)
    found[..., 0] = (np.arange(width) - pinhole.cx) / pinhole.fx
    found[..., 1] = ((np.arange(height) - pinhole.cy) / pinhole.fy)[:, None]
    return found


def _message(kind: str, values: Mapping[str, object]) -> bytes:
    """Return a message with these values by path, zeros else and empty data."""
    fields = [FieldSpec(p, parse_path(p), Reference("const", value=v)) for p, v in values.items()]
    return Encoder.build(PublishSpec(kind, kind, tuple(fields), shared_messages()), {}).encode()


def _point_fields(fields: Iterable[tuple[str, int, str]]) -> dict[str, object]:
    """Return PointField[] by path: name, place in the point in [B], NumPy's name of the type."""
    return {
        f"fields[{number}].{key}": value
        for number, (name, at, kind) in enumerate(fields)
        for key, value in {
            "name": name,
            "offset": at,
            "datatype": _FIELDS[kind],
            "count": 1,
        }.items()
    }


def _with_data(
    kind: str,
    given: AnyDict,
    size: int,
    shape: tuple[int, ...],
    dtype: str | np.dtype[np.void],
    frame_id: str,
) -> FrameMessage:
    """Return the layout of a message with data of some bytes, and with values by path."""
    empty = _message(kind, given | {"header.frame_id": frame_id})
    behind = kind == CLOUD  # is_dense: no, points that are too far or not there are NaN
    offset = len(empty) - behind
    template = empty[: offset - 4] + struct.pack("<I", size) + bytes(size + behind)
    return FrameMessage(kind, template, offset, shape, dtype, frame_id)


Reliability = Literal["reliable", "best_effort"]
"""Of a camera's topics."""

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

    def __init__(self, options: AnyMapping, tell: TextSink) -> None:
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
        if self._qos.reliability == "reliable":
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
    node: str, namespace: str | None, ros_args: Sequence[str], reliability: Reliability
) -> AnyDict:
    """Return the options of a camera's topics, as `CameraTopics` takes them.

    Args:
        node: name of the process's node.
        namespace: of that node.
        ros_args: ROS arguments of that node, such as remaps.
        reliability: of its topics.
    """
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
