"""What one generated decoding function is made of, collected by those who write its lines."""

from __future__ import annotations

from typing import Any

import numpy as np

from unicon_msgs_map.codec.binding import AnyArray


class Code:
    """What the function of one payload is made of.

    Args:
        raw: the payload that was walked.
        order: its byte order for `struct`.
        reject: whether numbers that are not finite are refused.

    Attributes:
        space: values that the lines use, by name.
        checks: lines that look at constants.
        work: lines that read and test numbers.
        writes: lines that write states, after all tests.
        reads: `struct` code and variable of a number that is read by itself, by its offset.
        times: variable of a time by that of its seconds.
        values: what is written to a state one by one, by its name.
    """

    def __init__(self, raw: bytes, order: str, reject: bool) -> None:
        self.raw, self.order, self.reject = raw, order, reject
        self.space: dict[str, Any] = {"size": len(raw)}
        self.checks: list[str] = []
        self.work: list[str] = []
        self.writes: list[str] = []
        self.reads: dict[int, tuple[str, str]] = {}
        self.times: dict[str, str] = {}
        self.values: dict[str, list[str]] = {}

    def stage(self) -> AnyArray:
        """Return the bytes of the present payload, where NumPy reads them, shape (len(raw),)."""
        known = self.space.get("staged")
        if known is None:
            # The body starts at byte 4; numbers are aligned in it, so it is aligned in memory.
            room = bytearray(len(self.raw) + 16)
            bytes_: AnyArray = np.frombuffer(room, np.uint8)
            self.shift = shift = -(bytes_.__array_interface__["data"][0] + 4) % 8
            known = self.space["staged"] = bytes_[shift : shift + len(self.raw)]
            self.space["stage"] = memoryview(room)[shift : shift + len(self.raw)]
            self.space["room"] = room
        stage: AnyArray = known
        return stage

    def read(self, offset: int, code: str) -> str:
        """Return the variable of a number that is read by itself."""
        if offset not in self.reads:
            self.reads[offset] = (code, f"v{len(self.reads)}")
        return self.reads[offset][1]
