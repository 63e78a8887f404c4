"""Message maps that drivers make of a robot file, instead of reading a map's YAML file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from unicon_msgs_map import MessageMap, PublishSpec, SubscribeSpec, parse_map
from unicon_msgs_map.layout.messages import shared_messages

__all__ = ["publish", "subscribe"]


def subscribe(topic: str, message: str, fields: Mapping[str, Any]) -> SubscribeSpec:
    """Return how a message is read.

    Args:
        topic: for error messages.
        message: its type, such as `unitree_go/msg/LowState`.
        fields: path in it to what it is written to, as in `subscribe` of a map.

    Raises:
        MapFileError: a field is wrong.
    """
    return _parsed("subscribe", topic, message, fields).subscribe[0]


def publish(topic: str, message: str, fields: Mapping[str, Any]) -> PublishSpec:
    """Return how a message is made; see `subscribe`.

    Raises:
        MapFileError: a field is wrong.
    """
    return _parsed("publish", topic, message, fields).publish[0]


def _parsed(way: str, topic: str, message: str, fields: Mapping[str, Any]) -> MessageMap:
    entry = {"topic": topic, "type": message, "fields": dict(fields)}
    return parse_map(json.dumps({way: [entry]}), shared_messages(), name=topic)
