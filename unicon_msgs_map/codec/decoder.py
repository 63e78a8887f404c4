"""Decoders: the bytes of one ROS message in, state arrays written; for bridges and replays.

Two paths, one meaning. The careful path (`layouts.py`) walks the payload with every length checked,
applies the declared policies, and compiles what it found; the fast path (`fast.py`) reads at those
offsets as long as every structural byte is the same. Any difference goes back to the walk.
"""

from __future__ import annotations

import numpy as np

from unicon_msgs_map.codec.binding import Arrays, Names, Variables
from unicon_msgs_map.codec.careful import Rejected
from unicon_msgs_map.codec.layouts import Layouts
from unicon_msgs_map.codec.targets import bind_targets
from unicon_msgs_map.layout.walker import Malformed
from unicon_msgs_map.spec import SubscribeSpec


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
