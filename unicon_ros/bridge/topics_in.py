"""Topics in: polls every subscription raw and drained to its latest message, in one input block.

Until a topic's first message its states are left alone, so that scripted commands rule. From then
on the topic rules: its latest message is applied in every tick, since the script goes on writing.
After `timeout` without a message the states go to zero (or stay, where the map says `hold`).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from unicon_msgs_map import Decoder
from unicon_ros import compat
from unicon_ros.bridge.qos import qos_profile
from unicon_ros.bridge.qos_events import QosEvents

__all__ = ["TopicIn"]

DRAIN = 64
"""Messages taken at most in one tick, however fast the peer writes; each take costs about 20 µs."""


class TopicIn:
    """One topic that we receive.

    Args:
        node: rclpy node.
        decoder: writes the states.
        message: Python class of the type.
        contested: whether other blocks write the same states, so that a message must be applied
            anew in every tick.
        group: callback group that keeps executors away, see `compat.polled_group`.
        warn: takes warnings.

    Attributes:
        topic: full name, after namespace and remaps.
        events: what its QoS events told.
        received: messages taken.
        dropped: of those, overtaken by a later one within the same tick.
        heard: a message has come.
        stale: no message came for the time-out.
        polled: False where this rclpy cannot be polled and an executor must call us.
    """

    def __init__(
        self,
        node: Any,
        decoder: Decoder,
        message: Any,
        contested: bool,
        group: Any,
        warn: Callable[[str], None],
    ) -> None:
        spec = decoder.spec
        self._node, self._warn, self._decoder = node, warn, decoder
        self._decode = decoder.decode
        self._contested = contested
        self._timeout_ns = 0 if spec.timeout is None else round(spec.timeout * 1e9)
        self._zero_when_stale = spec.on_timeout == "zero"
        self._pending: bytes | None = None
        options: dict[str, Any] = {"raw": True, "callback_group": group}
        profile = qos_profile(spec.qos)
        self.events = QosEvents(spec.topic, spec.qos, "subscription", lambda: self.received, warn)

        def create(**events: Any) -> Any:
            return node.create_subscription(
                message, spec.topic, self._called_back, profile, **options, **events
            )

        self.subscription = self.events.watch(create)
        take, self._release = compat.raw_take(self.subscription)
        self.polled = take is not None
        self._take = self._take_pending if take is None else take
        if take is None:  # no way to poll: subscribe again where executors may call us
            node.destroy_subscription(self.subscription)
            del options["callback_group"]
            self.subscription = self.events.watch(create)
        self.topic: str = self.subscription.topic_name
        self.received = self.dropped = 0
        self.heard = self.stale = False
        self._latest = b""
        self._ahead: bytes | None = None
        self._at_ns = 0
        self._told_rejected = ""
        if spec.qos.history == "keep_all":
            self._drain = DRAIN
        else:  # a queue of one is empty after a take; a second look costs 0.5 µs of 4
            self._drain = min(DRAIN, spec.qos.depth + 1) if spec.qos.depth > 1 else 0

    @property
    def states(self) -> tuple[str, ...]:
        """States that the topic writes."""
        return self._decoder.spec.states

    @property
    def rejected(self) -> int:
        """Messages that the map refused."""
        return self._decoder.rejected

    @property
    def last_error(self) -> str:
        """Why the last refused message was refused; empty if none was."""
        return self._decoder.last_error

    @property
    def silence(self) -> str:
        """What its time-out means, as a message."""
        what = "zero" if self._zero_when_stale else "held"
        return (
            f"topic {self.topic}: no message for {self._timeout_ns * 1e-9:g} s, "
            f"{', '.join(self.states)} {what}"
        )

    def prefetch(self) -> bool:
        """Take a message ahead without touching a state; True if there is one, now or before."""
        raw = self._take()
        if raw is not None:
            self.received += 1
            self.dropped += self._ahead is not None
            self._ahead = raw
        return self._ahead is not None

    def accept(self) -> None:
        """Use the message that was taken ahead just now; poll if there is none."""
        raw = self._ahead
        if raw is None:
            self.poll()
        else:
            self._ahead = None
            self._arrived(raw)

    def poll(self) -> None:
        """Take what has come and bring the states up to date; never raises."""
        raw = self._take()
        if raw is not None:
            self.received += 1
            if self._ahead is not None:
                self.dropped += 1
                self._ahead = None
            self._arrived(raw)
        elif self._ahead is not None:
            self.accept()
        elif self.heard:
            if self._timeout_ns and time.monotonic_ns() - self._at_ns > self._timeout_ns:
                self._lapsed()
            elif self._contested:
                self._decode(self._latest)

    def _arrived(self, raw: bytes) -> None:
        if self._drain:
            raw = self._drained(raw)
        if self._decode(raw):
            if self.stale:
                self._warn(f"topic {self.topic}: messages come again")
                self.stale = False
            self.heard, self._latest = True, raw
            if self._timeout_ns:
                self._at_ns = time.monotonic_ns()
            return
        reason = self._decoder.last_error
        if reason != self._told_rejected:  # once for each reason, not for each message
            self._told_rejected = reason
            self._warn(f"a message was refused: {reason}")
        if self.heard and self._contested:
            self._decode(self._latest)

    def _drained(self, raw: bytes) -> bytes:
        for _ in range(self._drain):
            newer = self._take()
            if newer is None:
                break
            raw = newer
            self.received += 1
            self.dropped += 1
        return raw

    def _lapsed(self) -> None:
        if not self.stale:
            self.stale = True
            self._warn(self.silence)
        if self._zero_when_stale:
            self._decoder.zero()
        elif self._contested:
            self._decode(self._latest)

    def _called_back(self, raw: bytes) -> None:
        self._pending = raw

    def _take_pending(self) -> bytes | None:
        raw, self._pending = self._pending, None
        return raw

    def close(self) -> None:
        """Destroy the subscription."""
        self._release()
        self._take = _nothing
        self._node.destroy_subscription(self.subscription)


def _nothing() -> bytes | None:
    return None
