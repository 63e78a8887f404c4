"""Topics out: one block per published topic, sent as bytes after the motors have their command."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from unicon_base.errors import one_line
from unicon_core.flow import Block
from unicon_msgs_map import Encoder
from unicon_ros import compat
from unicon_ros.bridge.qos import QosEvents, qos_profile

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
        warn: Callable[[str], None],
        prepare: Callable[[], None] | None = None,
        part: str = "map",
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
        self._every, self._wait = every, phase % every
        self.block = Block(f"publish {spec.topic}", self.tick, reads=spec.states)

    def tick(self) -> None:
        """Publish when it is due; never raises."""
        if self._wait:
            self._wait -= 1
            return
        self._wait = self._every - 1
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
