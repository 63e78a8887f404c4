"""Images and clouds as messages: bytes laid out once, so that a frame is rendered into its place.

The layouts are those of sensor_msgs/Image, PointCloud2 and CameraInfo in little-endian CDR; the
tests hold them against rosbags' codec.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from unicon_base.arrays import Array, Float32
from unicon_base.errors import UniconError, alternatives
from unicon_core.models.camera import Intrinsics

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
    out = _Cdr(frame_id, height, width)
    if kind == "cloud":
        out.fields([("x", 0, "f4"), ("y", 4, "f4"), ("z", 8, "f4")])
        out.pack("BII", 0, 12, row)
    else:
        out.text("rgb8" if kind == "color" else "32FC1")
        out.pack("BI", 0, row)
    offset = out.data(row * height)
    if kind == "cloud":
        out.pack("B", 0)  # is_dense: no, what is too far is NaN
    kind = CLOUD if kind == "cloud" else IMAGE
    return FrameMessage(kind, bytes(out.bytes), offset, shape, dtype, frame_id)


def cloud_message(width: int, point: np.dtype[np.void], frame_id: str) -> FrameMessage:
    """Return the layout of a cloud of points in no order (height 1).

    Args:
        width: number of points; those that are not there are to be NaN.
        point: what a point is: named fields, little endian.
        frame_id: of the header.
    """
    out = _Cdr(frame_id, 1, width)
    assert point.fields is not None
    fields = ((name, at, kind.str[1:]) for name, (kind, at, *_) in point.fields.items())
    out.fields(sorted(fields, key=lambda field: field[1]))
    out.pack("BII", 0, point.itemsize, point.itemsize * width)
    offset = out.data(point.itemsize * width)
    out.pack("B", 0)  # is_dense: no, see width
    return FrameMessage(CLOUD, bytes(out.bytes), offset, (width,), point)


def jpeg_message(most: int, frame_id: str) -> FrameMessage:
    """Return the layout of a CompressedImage with a JPEG; `put` writes it and tells its length.

    Args:
        most: largest size of the JPEG, [B].
        frame_id: of the header, an optical frame.
    """
    out = _Cdr(frame_id)
    out.text("jpeg")
    out.pack("I", 0)
    offset = len(out.bytes)
    return FrameMessage(JPEG, bytes(out.bytes) + bytes(most), offset, (most,), "|u1", frame_id)


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
    out = _Cdr(frame_id, height, width)
    out.text("plumb_bob")
    out.pack("I", 5)
    out.pack("d" * 5, *distortion)
    out.pack("d" * 9, fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, known)
    out.pack("d" * 9, known, 0.0, 0.0, 0.0, known, 0.0, 0.0, 0.0, known)
    out.pack("d" * 12, fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, known, 0.0)
    out.pack("IIIIIIB", *[0] * 7)
    return bytes(out.bytes)


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


class _Cdr:
    """Little-endian CDR, written once: of messages that begin with a header, and with a size."""

    def __init__(self, frame_id: str, *size: int) -> None:
        self.bytes = bytearray(b"\x00\x01\x00\x00")
        self.pack("iI", 0, 0)
        self.text(frame_id)
        self.pack("I" * len(size), *size)

    def pack(self, codes: str, *values: float) -> None:
        for code, value in zip(codes, values):
            size = struct.calcsize(code)
            self.bytes += bytes(-(len(self.bytes) - 4) % size)
            self.bytes += struct.pack("<" + code, value)

    def text(self, value: str) -> None:
        raw = value.encode() + b"\0"
        self.pack("I", len(raw))
        self.bytes += raw

    def fields(self, fields: Iterable[tuple[str, int, str]]) -> None:
        """Write PointField[]: name, place in the point in [B] and NumPy's name of the type."""
        given = list(fields)
        self.pack("I", len(given))
        for name, at, kind in given:
            self.text(name)
            self.pack("IBI", at, _FIELDS[kind], 1)

    def data(self, size: int) -> int:
        """Leave room for uint8[] and return where it begins, [B]."""
        self.pack("I", size)
        self.bytes += bytes(size)
        return len(self.bytes) - size
