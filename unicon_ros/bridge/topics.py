"""Topics: subscriptions, polled raw in one input block, and publishers, one block for each.

A publisher sends bytes after the motors have their command. A subscription is drained to its latest
message.

Until a topic's first message its states are left alone, so that scripted commands rule. From then
on the topic rules: its latest message is applied in every tick, since the script goes on writing.
After `timeout` without a message the states go to zero (where the map says so, they stay or become
NaN).
Messages are those that the map accepts: one that is refused, or that cannot be taken, is silence.
Of several that came within a tick, the newest that is accepted counts.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

from unicon_base import TextSink, one_line
from unicon_core.flow import Block
from unicon_msgs_map import Decoder, Encoder
from unicon_ros import compat
from unicon_ros.bridge.qos import QosEvents, qos_profile

DRAIN = 64
"""Messages taken at most in one tick, however fast the peer writes; each take costs about 20 µs."""

LOOK_BACK = 8
"""Messages that are looked at in one tick, from the newest on; refusing one costs 10 to 90 µs."""

REASONS = 10
"""Different reasons of refusals that are told; garbage has no end of them."""

RETRY_NS = 200_000_000
"""How long after an error the next message is tried to be taken, [ns]."""


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
        spec: what the map says of it.
        decoder: tells too what was refused, and why.
        topic: full name, after namespace and remaps.
        events: what its QoS events told.
        tap: gets the bytes of every message as it was taken, such as a recorder, or None.
        received: messages taken.
        dropped: of those, overtaken by later ones within the same tick, and never looked at.
        heard: a message was accepted.
        stale: no message was accepted for the time-out.
        polled: False where this rclpy cannot be polled and an executor must call us.
        why: nothing was accepted of late; empty if the last message was.
    """

    def __init__(
        self,
        node: Any,
        decoder: Decoder,
        message: Any,
        contested: bool,
        group: Any,
        warn: TextSink,
    ) -> None:
        spec = self.spec = decoder.spec
        self._node, self._warn, self.decoder = node, warn, decoder
        self._decode = decoder.decode
        self._contested = contested
        self._timeout_ns = 0 if spec.timeout is None else round(spec.timeout * 1e9)
        self._holds_when_stale = spec.on_timeout == "hold"
        pending: deque[bytes] = deque(maxlen=1)
        options = {"raw": True, "callback_group": group}
        profile = qos_profile(spec.qos)
        self.events = QosEvents(spec.topic, spec.qos, "subscription", lambda: self.received, warn)

        def heard(raw: bytes) -> None:  # rclpy looks at the signature
            pending.append(raw)

        def create(**events: Any) -> Any:
            return node.create_subscription(
                message, spec.topic, heard, profile, **options, **events
            )

        self.subscription = self.events.watch(create)
        take, self._release = compat.raw_take(self.subscription)
        self.polled = take is not None
        self._take = take or (lambda: pending.pop() if pending else None)
        if take is None:  # no way to poll: subscribe again where executors may call us
            node.destroy_subscription(self.subscription)
            del options["callback_group"]
            self.subscription = self.events.watch(create)
        self.topic: str = self.subscription.topic_name
        self.tap: Callable[[bytes], object] | None = None
        self.received = self.dropped = 0
        self.heard = self.stale = False
        self._latest = b""
        self._ahead: deque[bytes] = deque()
        self._at_ns = self._again_ns = 0
        self._again = self._take
        self._told_rejected: set[str] = set()
        self.why = ""
        if spec.qos.history == "keep_all":
            self._drain = DRAIN
        else:  # a queue of one is empty after a take; a second look costs 0.5 µs of 4
            self._drain = min(DRAIN, spec.qos.depth + 1) if spec.qos.depth > 1 else 0

    @property
    def silence(self) -> str:
        """What its time-out means, as a message."""
        what = {"hold": "held"}.get(self.spec.on_timeout, self.spec.on_timeout)
        why = f" (the last: {self.why})" if self.why else ""
        return (
            f"topic {self.topic}: no {'accepted ' if self.why else ''}message for "
            f"{self._timeout_ns * 1e-9:g} s, {', '.join(self.spec.states)} {what}{why}"
        )

    def prefetch(self) -> bool:
        """Take a message ahead without touching a state; True if there is one, now or before."""
        self._look()
        return bool(self._ahead)

    def accept(self) -> None:
        """Use the message that was taken ahead just now; poll if there is none."""
        if self._ahead:
            self._use()
        else:
            self.poll()

    def poll(self) -> None:
        """Take what has come and bring the states up to date; never raises."""
        self._look()
        if self._ahead:
            self._use()
        elif self.heard:
            self._silent()

    def _look(self) -> bool:
        """Take one message, if there is one."""
        try:
            raw = self._take()
        except Exception as error:  # the middleware is gone, or was for a moment
            self._cannot_take(error)
            return False
        if raw is None:
            return False
        self.received += 1
        if self.tap is not None:
            self.tap(raw)
        self._ahead.append(raw)
        if len(self._ahead) > DRAIN:
            self.dropped += 1
            self._ahead.popleft()
        return True

    def _use(self) -> None:
        """Apply the newest message that is accepted; where none is, nothing has come."""
        ahead = self._ahead
        for _ in range(self._drain):
            if not self._look():
                break
        raw = ahead.pop()
        if not self._decode(raw):
            older = self._accepted_before()
            if older is None:
                return
            raw = older
        if ahead:
            self._forget()
        if self.stale:
            self._warn(f"topic {self.topic}: messages come again")
            self.stale = False
        self.heard, self._latest, self.why = True, raw, ""
        if self._timeout_ns:
            self._at_ns = time.monotonic_ns()

    def _accepted_before(self) -> bytes | None:
        """The newest message was refused: apply one before it and return it, if there is any."""
        self._refused(self.decoder.last_error)
        for _ in range(min(len(self._ahead), LOOK_BACK - 1)):
            raw = self._ahead.pop()
            if self._decode(raw):
                return raw
            self._refused(self.decoder.last_error)
        self._forget()
        if self.heard:
            self._silent()
        return None

    def _forget(self) -> None:
        """What is older than the messages that were looked at does not count any more."""
        self.dropped += len(self._ahead)
        self._ahead.clear()

    def _refused(self, reason: str) -> None:
        self.why = reason
        told = self._told_rejected
        if reason not in told and len(told) < REASONS:  # not for each message
            told.add(reason)
            self._warn(f"a message was refused: {reason}")

    def _silent(self) -> None:
        """Nothing was accepted in this tick: only the age of what was accepted last counts."""
        lapsed = self._timeout_ns and time.monotonic_ns() - self._at_ns > self._timeout_ns
        if lapsed and not self.stale:
            self.stale = True
            self._warn(self.silence)
        if lapsed and not self._holds_when_stale:
            self.decoder.lapse()
        elif self._contested:
            self._decode(self._latest)

    def _cannot_take(self, error: Exception) -> None:
        """Go on as with a silent topic, and try again now and then: each error costs its time."""
        if self._take != self._retry:
            self._again, self._take = self._take, self._retry
            self.why = f"they cannot be taken: {one_line(error)}"
            self._warn(f"topic {self.topic}: messages cannot be taken ({one_line(error)})")
        self._again_ns = time.monotonic_ns() + RETRY_NS

    def _retry(self) -> bytes | None:
        if time.monotonic_ns() < self._again_ns:
            return None
        raw = self._again()
        self._take = self._again
        self._warn(f"topic {self.topic}: messages can be taken again")
        return raw

    def close(self) -> None:
        """Destroy the subscription."""
        self._release()
        self._take = self._again = _nothing
        self._node.destroy_subscription(self.subscription)


def _nothing() -> bytes | None:
    return None


GIVE_UP = 100
"""Failures in a row after which a topic is given up: it must not cost every tick."""


class TopicOut:
    """One topic that we publish.

    Args:
        node: rclpy node.
        encoder: makes the bytes.
        message: Python class of the type.
        every: publish every so many ticks.
        phase: number of the first tick of those, so that topics do not all fall on one tick.
        group: callback group of its events.
        warn: takes warnings.
        prepare: called before each encoding: brings arrays up to date that are not states.
        part: whose messages these are, where a node has several publishers of one topic.
        lazy: publish only while there are subscribers, because the messages cost much time.

    Attributes:
        spec: what the map says of it.
        part: as given.
        events: what its QoS events told.
        topic: full name, after namespace and remaps.
        tap: gets the bytes of every message too, such as a recorder, or None.
        published: messages sent.
        failed: messages that the middleware refused.
        failing: of those, how many in a row until now.
        last_error: what it said last; empty if it never did.
    """

    def __init__(
        self,
        node: Any,
        encoder: Encoder,
        message: Any,
        every: int,
        phase: int,
        group: Any,
        warn: TextSink,
        prepare: Callable[[], None] | None = None,
        part: str = "map",
        lazy: bool = False,
    ) -> None:
        spec = encoder.spec
        self.part = part
        self._node, self._warn = node, warn
        self.events = QosEvents(spec.topic, spec.qos, "publisher", lambda: self.published, warn)
        profile = qos_profile(spec.qos)
        create = partial(node.create_publisher, message, spec.topic, profile, callback_group=group)
        self.publisher = self.events.watch(create)
        self.spec = spec
        self.topic: str = self.publisher.topic_name
        self.tap: Callable[[bytes], object] | None = None
        self.published = 0
        self.failed = self.failing = 0
        self.last_error = ""
        self._encode = encoder.encode if prepare is None else prepared(prepare, encoder.encode)
        self._prepared = prepare is not None  # costs more than it would save
        self._publish, self._release = compat.raw_publish(self.publisher)
        self._every, self._wait, self._lazy = every, phase % every, lazy
        self.block = Block(f"publish {spec.topic}", self.tick, reads=spec.states)

    def tick(self) -> None:
        """Publish when it is due; never raises."""
        if self._wait:
            self._wait -= 1
            return
        self._wait = self._every - 1
        if self._lazy and not self.publisher.get_subscription_count():
            return
        raw = self._encode()
        if self.tap is not None:
            self.tap(raw)
        try:
            self._publish(raw)
        except Exception as error:  # whatever the middleware says, the tick goes on
            self._refused(error)
        else:
            self.published += 1
            self.failing = 0

    def warm_up(self) -> None:
        """Encode without publishing, if the next tick does: code and constants get warm."""
        if not self._wait and not self._prepared:
            self._encode()

    def now(self) -> None:
        """Publish at once, due or not; never raises."""
        self._wait = 0
        self.tick()

    def flush(self, timeout: float = 0.1) -> None:
        """Publish at once and wait until readers have it; never raises."""
        self.now()
        compat.wait_for_readers(self.publisher, timeout)

    def _refused(self, error: Exception) -> None:
        self.failed += 1
        self.failing += 1
        self.last_error = one_line(error)
        if self.failed == 1:
            self._warn(f"topic {self.topic}: a message was not published ({self.last_error})")
        if self.failing == GIVE_UP:
            self._warn(f"topic {self.topic}: given up after {GIVE_UP} messages were not published")
            self._wait = 1 << 62

    def close(self) -> None:
        """Destroy the publisher."""
        self._wait = 1 << 62
        self._release()
        self._node.destroy_publisher(self.publisher)


def prepared(prepare: Callable[[], None], encode: Callable[[], bytes]) -> Callable[[], bytes]:
    """Return what encodes after arrays that are not states were brought up to date."""

    def encoded() -> bytes:
        prepare()
        return encode()

    return encoded
