"""QoS: from the words of a message map to rclpy's profile, for publishers and subscriptions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from unicon_msgs_map.spec import Qos
from unicon_ros import compat

__all__ = ["incompatibility", "qos_profile"]


def qos_profile(qos: Qos) -> Any:
    """Return rclpy's profile of a map's QoS; times in [s] there, Durations here."""
    from rclpy.duration import Duration
    from rclpy.qos import (
        DurabilityPolicy,
        HistoryPolicy,
        LivelinessPolicy,
        QoSProfile,
        ReliabilityPolicy,
    )

    values: dict[str, Any] = {
        "reliability": ReliabilityPolicy[qos.reliability.upper()],
        "durability": DurabilityPolicy[qos.durability.upper()],
        "history": HistoryPolicy[qos.history.upper()],
        "liveliness": LivelinessPolicy[qos.liveliness.upper()],
        "depth": qos.depth,
    }
    for name, seconds in (
        ("deadline", qos.deadline),
        ("lifespan", qos.lifespan),
        ("liveliness_lease_duration", qos.liveliness_lease),
    ):
        if seconds is not None:
            values[name] = Duration(nanoseconds=round(seconds * 1e9))
    return QoSProfile(**values)


def incompatibility(topic: str, qos: Qos, peer: str, warn: Callable[[str], None]) -> Any:
    """Return event callbacks that tell once for each policy when a peer's QoS does not match.

    Args:
        topic: for the message.
        qos: ours.
        peer: what the other side is: `publisher` or `subscription`.
        warn: takes the message.
    """
    told: set[str] = set()

    def tell(event: Any) -> None:
        policy = compat.incompatible_policy(event)
        if policy not in told:
            told.add(policy)
            ours = getattr(qos, policy, None)
            said = f" (ours: {ours})" if ours is not None else ""
            warn(
                f"topic {topic}: a {peer} has an incompatible {policy}{said}, so nothing passes "
                f"between us; set qos.{policy} of the topic in the message map, or the peer's"
            )

    own = "subscription" if peer == "publisher" else "publisher"
    return compat.event_callbacks(own, tell)
