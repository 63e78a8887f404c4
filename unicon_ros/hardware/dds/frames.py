"""Frames: checks raw messages before they are decoded, for both ends of a wire over DDS."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from unicon_msgs_map import Decoder, SubscribeSpec
from unicon_msgs_map.codec.checksum import unitree_crc
from unicon_msgs_map.layout.messages import Struct
from unicon_msgs_map.layout.paths import Reference, parse_path
from unicon_msgs_map.layout.walker import static_size
from unicon_msgs_map.spec import FieldSpec
from unicon_ros.hardware.wire import Counts

HEADER = b"\x00\x01"
"""Plain CDR (XCDR1), little endian: all that these robots send. XCDR2 has other sizes."""
PADDING = 3
"""Bytes to a multiple of 4 that may follow a message, without being told."""


class Frames:
    """Messages of one type: header, length and checksum looked at, then read into arrays.

    Args:
        spec: how they are read.
        arrays: what they are read into.
        counts: gets what is refused.
        checked: Unitree's checksum must be right.
        orientation: state of a quaternion, which must have norm 1, or "".
        lengths: of sequences in front of which nothing varies, by field: other lengths are refused.
        size: with the header, in bytes; of a type with sequences or texts 0 leaves it to decoding.

    Raises:
        MapStateError: arrays and mapping do not fit.
    """

    def __init__(
        self,
        spec: SubscribeSpec,
        arrays: Mapping[str, NDArray[np.generic]],
        counts: Counts,
        *,
        checked: bool = True,
        orientation: str = "",
        lengths: Mapping[str, int] | None = None,
        size: int = 0,
    ) -> None:
        self._counts, self._checked = counts, checked
        self._decoder = Decoder.build(spec, arrays)
        if orientation:
            self._decoder.need_orientation(orientation)
        message = spec.messages.struct(spec.type)
        self._lengths = {offset_of(message, name): (name, n) for name, n in (lengths or {}).items()}
        body = static_size(message, 0)
        self.size = size if body is None else 4 + body
        self._least = self.size or max(self._lengths, default=0) + 4
        if checked:
            self._buffer = bytearray(self.size)
            field = FieldSpec("crc", parse_path("crc"), Reference("const", value=0))
            self._crc = unitree_crc(field, message, self._buffer)

    def good(self, raw: bytes) -> bool:
        """Tell whether header, length and checksum are right; count what is not."""
        if raw[:2] != HEADER:
            self._counts.refuse("not little-endian XCDR1", f"header {raw[:4].hex()}")
            return False
        for at, (name, wanted) in self._lengths.items():
            found = int.from_bytes(raw[at : at + 4], "little")
            if len(raw) >= at + 4 and found != wanted:
                self._counts.refuse(f"another length of {name}", f"{found}, not {wanted}")
                return False
        if len(raw) < self._least or (self.size and len(raw) > self.size + PADDING):
            reason = "short" if len(raw) < self._least else "long"
            self._counts.refuse(reason, f"{len(raw)} bytes, not {self._least}")
            return False
        if self._checked:
            self._buffer[4:] = raw[4 : self.size]
            crc, said = self._crc(), int.from_bytes(raw[self.size - 4 : self.size], "little")
            if crc != said:
                self._counts.refuse("wrong CRC", f"{said:08x}, not {crc:08x}")
                return False
        return True

    def read(self, raw: bytes) -> bool:
        """Read a good message into the arrays; where it is refused nothing is written."""
        if self._decoder.decode(raw):
            return True
        self._counts.refuse("impossible values", self._decoder.last_error)
        return False


def offset_of(message: Struct, name: str) -> int:
    """Return where a field stands in a frame, of 4-byte alignment, behind what has one size.

    Of a sequence it is where its length stands.
    """
    at = 0
    for field, kind in message.fields.items():
        if field == name:
            break
        size = static_size(kind, at % 8)
        assert size is not None
        at += size
    return 4 + at + -at % 4
