"""Images and clouds as messages: bytes laid out once, so that a frame is rendered into its place.

The layouts are those of sensor_msgs/Image and sensor_msgs/PointCloud2 in little-endian CDR; the
tests hold them against rosbags' codec.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import UniconError, alternatives

__all__ = ["KINDS", "FrameMessage", "frame_message", "rays"]

IMAGE, CLOUD = "sensor_msgs/msg/Image", "sensor_msgs/msg/PointCloud2"
KINDS = ("color", "depth", "cloud")
"""`color` rgb8; `depth` 32FC1 in [m] along the view axis (REP-118); `cloud` x, y, z in [m]."""

_FLOAT32 = 7  # PointField.FLOAT32
_STAMP = 4  # behind the encapsulation header


@dataclass(frozen=True)
class FrameMessage:
    """The layout of one message.

    Attributes:
        type: message type.
        template: all bytes, with zeros for stamp and data.
        offset: where the data begin, [B].
        shape: of the data: (height, width, 3) or (height, width).
        dtype: of the data.
    """

    type: str
    template: bytes
    offset: int
    shape: tuple[int, ...]
    dtype: str

    def data(self, buffer: Any) -> NDArray[Any]:
        """Return the view of the data in a message's buffer; to write into or to read."""
        view: NDArray[Any] = np.ndarray(self.shape, self.dtype, buffer, self.offset)
        return view

    def stamp(self, buffer: Any, stamp_ns: int) -> None:
        """Write the header's stamp, [ns]."""
        struct.pack_into("<iI", buffer, _STAMP, *divmod(stamp_ns, 1_000_000_000))


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
    out = _Cdr()
    shape: tuple[int, ...]
    out.pack("iI", 0, 0)
    out.text(frame_id)
    out.pack("II", height, width)
    if kind == "cloud":
        out.pack("I", 3)
        for number, name in enumerate("xyz"):
            out.text(name)
            out.pack("IBI", 4 * number, _FLOAT32, 1)
        out.pack("BII", 0, 12, 12 * width)
        size, shape, dtype = 12 * width * height, (height, width, 3), "<f4"
    else:
        color = kind == "color"
        out.text("rgb8" if color else "32FC1")
        pixel = 3 if color else 4
        out.pack("BI", 0, pixel * width)
        size = pixel * width * height
        shape, dtype = ((height, width, 3), "|u1") if color else ((height, width), "<f4")
    out.pack("I", size)
    offset = len(out.bytes)
    out.bytes += bytes(size)
    if kind == "cloud":
        out.pack("B", 0)  # is_dense: no, what is too far is NaN
    return FrameMessage(CLOUD if kind == "cloud" else IMAGE, bytes(out.bytes), offset, shape, dtype)


def rays(width: int, height: int, fovy: float) -> NDArray[np.float32]:
    """Return x, y, z per metre of depth of each pixel, optical frame, shape (height, width, 3).

    Args:
        width: in pixels.
        height: in pixels.
        fovy: vertical field of view of a pinhole camera with square pixels, [rad].
    """
    focal = 0.5 * height / np.tan(0.5 * fovy)  # pixels
    right = (np.arange(width) + 0.5 - 0.5 * width) / focal
    down = (np.arange(height) + 0.5 - 0.5 * height) / focal
    found = np.ones((height, width, 3), np.float32)
    found[..., 0] = right
    found[..., 1] = down[:, None]
    return found


class _Cdr:
    """Little-endian CDR, written once."""

    def __init__(self) -> None:
        self.bytes = bytearray(b"\x00\x01\x00\x00")

    def pack(self, codes: str, *values: int) -> None:
        for code, value in zip(codes, values):
            size = struct.calcsize(code)
            self.bytes += bytes(-(len(self.bytes) - 4) % size)
            self.bytes += struct.pack("<" + code, value)

    def text(self, value: str) -> None:
        raw = value.encode() + b"\0"
        self.pack("I", len(raw))
        self.bytes += raw
