"""Ends of services: requests and responses as rosbags' objects; not for the tick's hot path."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from unicon_msgs_map.layout.messages import shared_messages
from unicon_ros.hardware.dds.participant import Participant


class ServiceEnd:
    """One end of a service, for a client or a server.

    Args:
        participant: of the robot's domain.
        topics: type of message to its topic.
        writes: type that this end writes.
        reads: type that this end reads.
    """

    def __init__(
        self, participant: Participant, topics: Mapping[str, str], writes: str, reads: str
    ) -> None:
        messages = shared_messages()
        self._writer = participant.writer(topics[writes], messages.struct(writes))
        self._reader = participant.reader(topics[reads], messages.struct(reads))
        self._store, self._reads = messages.store, reads
        self._types: Any = messages.store.types

    @property
    def there(self) -> bool:
        """Whether the other end is."""
        return self._writer.matched and bool(self._reader.sources)

    def _say(self, message: Any) -> None:
        """Write a message, zeros behind it up to a multiple of 4."""
        raw = bytes(self._store.serialize_cdr(message, message.__msgtype__))
        self._writer.write(raw + bytes(-len(raw) % 4))

    def _heard(self) -> Iterator[Any]:
        """Give what has come; what is no message is left."""
        for raw, info in self._reader.take():
            if info.valid_data:
                try:
                    said = self._store.deserialize_cdr(raw, self._reads)
                except Exception:  # whatever rosbags makes of garbage
                    continue
                yield said
