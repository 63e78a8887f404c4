"""Decoders: the bytes of one ROS message in, state arrays written; for bridges and replays.

Two paths, one meaning. The careful path (`layouts.py`) walks the payload with every length checked,
applies the declared policies, and compiles what it found; the fast path (`fast.py`) reads at those
offsets as long as every structural byte is the same. Any difference goes back to the walk.
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
from unicon_msgs_map.layout.walker import Malformed, WalkedFields, Want, walk
from unicon_msgs_map.spec import SubscribeSpec

KEPT_LAYOUTS = 4  # publishers with layouts of their own that may alternate on one topic
IMU = "sensor_msgs/msg/Imu"


@dataclass(frozen=True)
class _Layout:
    size: int
    structure: tuple[bytes, ...]
    fast: Callable[[bytes], bool | None]
    runs: list[Run]


class Layouts:
    """Reads payloads carefully, and remembers how to read the like of them fast.

    Args:
        spec: the mapping entry.
        message: its type.
        targets: what it writes and requires.

    Attributes:
        spec: the mapping entry.
        targets: what it writes and requires.
        fast: the fast path of the last layout.
        derived: number of times that a layout was derived anew.
        stamp: one element, stamp of the last message in [ns].
        kept: the layouts that are remembered, the latest first.
    """

    def __init__(self, spec: SubscribeSpec, message: Struct, targets: list[Target]) -> None:
        self.spec, self._message, self.targets = spec, message, targets
        self.fast: Callable[[bytes], bool | None] = _miss
        self.derived = 0
        self.stamp = [0]
        self.kept: list[_Layout] = []
        self._loose = False
        self._orientation = ""
        self._want = Want()
        for target in targets:
            self._want.add(target.number, target.field.steps, message)
        stamp = _stamp_path(message)
        if stamp:
            self._want.add(STAMP, stamp, message)

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
        self.kept.clear()
        self.fast = _miss

    def read(self, raw: bytes) -> None:
        """Write the states that a message carries.

        Raises:
            Malformed: it is not a message of this type.
            Rejected: the policies of the entry refuse it; nothing was written.
        """
        for kept in self.kept:
            done = kept.fast(raw)
            if done is not None:
                self.fast, runs = kept.fast, kept.runs
                break
        else:
            found = walk(raw, self._message, self._want)
            runs = select(found, self.spec, self.targets, self.stamp)
            if self._orientation:
                runs += orientation(found, runs, self._orientation)
            self._remember(raw, found, runs)
            done = self.fast(raw)
        if not done:
            apply(raw, runs, self.spec.nonfinite)

    def _remember(self, raw: bytes, found: WalkedFields, runs: list[Run]) -> None:
        self.derived += 1
        hard = merge(found.hard)
        structure = tuple(raw[start:end] for start, end in hard)
        if any(kept.size == len(raw) and kept.structure == structure for kept in self.kept):
            # Only padding or unread bytes differ: from now on they are not compared.
            self._loose = True
            self.kept.clear()
        reject = self.spec.nonfinite == "reject"
        self.fast = compile_fast(raw, found.order, hard, runs, reject, self._loose)
        self.kept.insert(0, _Layout(len(raw), structure, self.fast, runs))
        del self.kept[KEPT_LAYOUTS:]


def _miss(_: bytes) -> bool | None:
    return None


def _stamp_path(message: Struct) -> Path:
    for path, owner in (("header.stamp", HEADER), ("stamp", TIME), ("clock", TIME)):
        steps = parse_path(path)
        kind = message.fields.get(steps[0][0])
        if isinstance(kind, Struct) and kind.name == owner:
            return steps
    return ()


class Decoder(Layouts):
    """State arrays from one message type; make it with `Decoder.build`.

    Attributes:
        spec: the mapping entry.
        received: number of accepted messages.
        rejected: number of refused ones.
        last_error: why the last refused message was refused; empty if none was.
    """

    received = rejected = 0
    last_error = ""

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
        return self.stamp[0]

    def elements(self, state: str) -> set[int]:
        """Return which elements of a state, in C order, a message may write."""
        bounds = [target.bound for target in self.targets if target.bound is not None]
        return {e for bound in bounds if bound.field.source.name == state for e in bound.elements}

    def decode(self, raw: bytes) -> bool:
        """Write the states that a message carries.

        Args:
            raw: encapsulation header and body, either byte order.

        Returns:
            Whether the message was accepted. If not, nothing was written, `rejected` counts it
            and `last_error` describes it. Never raises on any bytes.
        """
        try:
            if self.fast(raw):
                self.received += 1
                return True
        except FloatingPointError:  # somebody's np.seterr: a subnormal in a cast, nothing wrong
            pass
        with np.errstate(all="ignore"):
            return self._decode(raw)

    def lapse(self) -> None:
        """Set every element that this decoder writes to zero, time stamps excepted.

        Where the map says `on_timeout: unset`, to NaN.
        """
        value = float("nan") if self.spec.on_timeout == "unset" else 0
        for target in self.targets:
            if target.bound is not None and not target.is_time:
                target.bound.flat[list(target.bound.elements)] = value

    def _decode(self, raw: bytes) -> bool:
        try:
            self.read(bytes(raw))
        except (Malformed, Rejected) as error:
            self.rejected += 1
            self.last_error = f"{self.spec.topic} ({self.spec.type}): {error}"
            return False
        self.received += 1
        return True
