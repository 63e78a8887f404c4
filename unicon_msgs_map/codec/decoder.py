"""Decoders: the bytes of one ROS message in, state arrays written; for bridges and replays.

Two paths, one meaning. The careful path walks the payload with every length checked, applies the
declared policies, and compiles what it found; the fast path (`fast.py`) reads at those offsets as
long as every structural byte is the same. Any difference goes back to the walk.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from unicon_msgs_map.codec.binding import Arrays, Names, Variables
from unicon_msgs_map.codec.careful import (
    COVARIANCE,
    STAMP,
    Rejected,
    Run,
    apply,
    orientation,
    select,
)
from unicon_msgs_map.codec.fast import compile_fast, merge
from unicon_msgs_map.codec.targets import Target, bind_targets
from unicon_msgs_map.layout.messages import HEADER, TIME, Struct
from unicon_msgs_map.layout.paths import Path, parse_path
from unicon_msgs_map.layout.walker import Found, Malformed, Want, walk
from unicon_msgs_map.spec import SubscribeSpec

__all__ = ["Decoder"]

KEPT_LAYOUTS = 4  # publishers with layouts of their own that may alternate on one topic
IMU = "sensor_msgs/msg/Imu"


_Fast = Callable[[bytes], bool | None]


@dataclass(frozen=True)
class _Layout:
    size: int
    structure: tuple[bytes, ...]
    fast: _Fast
    runs: list[Run]


class Decoder:
    """State arrays from one message type; make it with `Decoder.build`.

    Attributes:
        spec: the mapping entry.
        received: number of accepted messages.
        rejected: number of refused ones.
        derived: number of times that a layout was derived anew.
        last_error: why the last refused message was refused; empty if none was.
    """

    __slots__ = (
        "_fast",
        "_layouts",
        "_loose",
        "_message",
        "_orientation",
        "_stamp",
        "_targets",
        "_want",
        "derived",
        "last_error",
        "received",
        "rejected",
        "spec",
    )

    def __init__(self, spec: SubscribeSpec, message: Struct, targets: list[Target]) -> None:
        self.spec = spec
        self.received = 0
        self.rejected = 0
        self.derived = 0
        self.last_error = ""
        self._message = message
        self._targets = targets
        self._want = Want()
        for target in targets:
            self._want.add(target.number, target.field.steps, message)
        stamp = _stamp_path(message)
        if stamp:
            self._want.add(STAMP, stamp, message)
        self._stamp = [0]
        self._layouts: list[_Layout] = []
        self._fast: _Fast = _miss
        self._loose = False
        self._orientation = ""

    @classmethod
    def build(
        cls,
        spec: SubscribeSpec,
        arrays: Arrays,
        names: Names | None = None,
        variables: Variables | None = None,
    ) -> Decoder:
        """Prepare a mapping entry against arrays, which are written in place from then on.

        Args:
            spec: topic, type, fields and policies.
            arrays: state arrays by name, any shape; elements count in C order.
            names: element names per state; they order arrays that come with names, unless the
                `$variable` on the message's names is as long as the selection.
            variables: values of `$name`: lists of element names.

        Raises:
            MapStateError: a state, variable, size or dtype does not fit.
            MessageTypeError: the type or a path in it is unknown.
        """
        message = spec.messages.struct(spec.type)
        targets = bind_targets(spec, message, arrays, names or {}, variables or {})
        return cls(spec, message, targets)

    @property
    def stamp_ns(self) -> int:
        """Stamp of the last accepted message in [ns]; 0 where the type carries none."""
        return self._stamp[0]

    def elements(self, state: str) -> set[int]:
        """Return which elements of a state, in C order, a message may write."""
        bounds = [target.bound for target in self._targets if target.bound is not None]
        return {e for bound in bounds if bound.field.source.name == state for e in bound.elements}

    def need_orientation(self, state: str) -> None:
        """Refuse messages without an orientation from now on.

        A robot that balances by one that is not there would be blind: a quaternion whose norm is
        not 1, or an Imu that says it has none (-1 in `orientation_covariance`).

        Args:
            state: that the quaternion is written to.
        """
        self._orientation = state
        if self.spec.type == IMU:
            self._want.add(COVARIANCE, parse_path("orientation_covariance[0]"), self._message)
        self._layouts.clear()
        self._fast = _miss

    def decode(self, raw: bytes) -> bool:
        """Write the states that a message carries.

        Args:
            raw: encapsulation header and body, either byte order.

        Returns:
            Whether the message was accepted. If not, nothing was written, `rejected` counts it
            and `last_error` describes it. Never raises on any bytes.
        """
        try:
            if self._fast(raw):
                self.received += 1
                return True
        except FloatingPointError:  # somebody's np.seterr: a subnormal in a cast, nothing wrong
            pass
        with np.errstate(all="ignore"):
            return self._decode(raw)

    def zero(self) -> None:
        """Set every element that this decoder writes to zero, time stamps excepted."""
        for target in self._targets:
            if target.bound is not None and not target.is_time:
                target.bound.flat[list(target.bound.elements)] = 0

    def _decode(self, raw: bytes) -> bool:
        raw = bytes(raw)
        for kept in self._layouts:
            done = kept.fast(raw)
            if done is None:
                continue
            self._fast = kept.fast
            return self._accept(raw, kept.runs, written=done)
        try:
            found = walk(raw, self._message, self._want)
            runs = select(found, self.spec, self._targets, self._stamp)
            if self._orientation:
                runs += orientation(found, runs, self._orientation)
        except (Malformed, Rejected) as error:
            return self._refuse(str(error))
        fast = self._remember(raw, found, runs)
        return self._accept(raw, runs, written=bool(fast(raw)))

    def _remember(self, raw: bytes, found: Found, runs: list[Run]) -> _Fast:
        self.derived += 1
        hard = merge(found.hard)
        structure = tuple(raw[start:end] for start, end in hard)
        if any(kept.size == len(raw) and kept.structure == structure for kept in self._layouts):
            # Only padding or unread bytes differ: from now on they are not compared.
            self._loose = True
            self._layouts.clear()
        fast = compile_fast(raw, found.order, hard, runs, self.spec.nonfinite, self._loose)
        self._fast = fast
        self._layouts.insert(0, _Layout(len(raw), structure, fast, runs))
        del self._layouts[KEPT_LAYOUTS:]
        return fast

    def _accept(self, raw: bytes, runs: list[Run], *, written: bool) -> bool:
        """Apply a message by the careful path, unless the fast one already did."""
        if not written:
            try:
                apply(raw, runs, self.spec.nonfinite)
            except Rejected as error:
                return self._refuse(str(error))
        self.received += 1
        return True

    def _refuse(self, reason: str) -> bool:
        self.rejected += 1
        self.last_error = f"{self.spec.topic} ({self.spec.type}): {reason}"
        return False


def _miss(_: bytes) -> bool | None:
    return None


def _stamp_path(message: Struct) -> Path:
    header = message.field("header")
    if header is not None and isinstance(header.type, Struct) and header.type.name == HEADER:
        return (("header", None), ("stamp", None))
    for name in ("stamp", "clock"):
        member = message.field(name)
        if member is not None and isinstance(member.type, Struct) and member.type.name == TIME:
            return ((name, None),)
    return ()
