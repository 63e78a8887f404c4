"""Messages as rosbags' objects, for what robots are asked now and then; not for the hot path."""

from __future__ import annotations

from typing import Any

from unicon_msgs_map.layout.messages import shared_messages


def packed(message: Any) -> bytes:
    """Return a message as bytes, zeros behind it up to a multiple of 4."""
    raw = bytes(shared_messages().store.serialize_cdr(message, message.__msgtype__))
    return raw.ljust(len(raw) + -len(raw) % 4, b"\0")


def unpacked(raw: bytes, name: str) -> Any | None:
    """Return bytes as a message; None where they are none."""
    messages = shared_messages()
    messages.struct(name)  # registers it
    try:
        return messages.store.deserialize_cdr(raw, name)
    except Exception:  # whatever rosbags makes of garbage
        return None
