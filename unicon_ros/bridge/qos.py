"""QoS: from the words of a message map to rclpy's profile, for publishers and subscriptions."""

from __future__ import annotations

from typing import Any

from unicon_msgs_map.spec import Qos

LATEST = Qos(reliability="best_effort", depth=1)
"""For streams of states: only the newest counts, and nothing is sent again."""

LATCHED = Qos(durability="transient_local", depth=1)
"""The last message goes to late joiners too."""


def qos_profile(qos: Qos) -> Any:
    """Return rclpy's profile of a map's QoS; times in [s] there, Durations here."""
    from rclpy import qos as ros
    from rclpy.duration import Duration

    values: dict[str, Any] = {"depth": qos.depth}
    for word in ("reliability", "durability", "history", "liveliness"):
        values[word] = getattr(ros, f"{word.capitalize()}Policy")[getattr(qos, word).upper()]
    for name, seconds in (
        ("deadline", qos.deadline),
        ("lifespan", qos.lifespan),
        ("liveliness_lease_duration", qos.liveliness_lease),
    ):
        if seconds is not None:
            values[name] = Duration(nanoseconds=round(seconds * 1e9))
    return ros.QoSProfile(**values)
