"""The QoS of a recorded topic, in the words of `ros2 bag`: what its player offers again.

Numbers, as Humble writes them: later releases, which write words, still read both.
"""

from __future__ import annotations

from typing import Any

import yaml

from unicon_msgs_map import Qos

# Values of rmw/types.h.
_HISTORY = {"keep_last": 1, "keep_all": 2}
_RELIABILITY = {"reliable": 1, "best_effort": 2}
_DURABILITY = {"transient_local": 1, "volatile": 2}
_LIVELINESS = {"automatic": 1, "manual_by_topic": 3}
_FOREVER = (1 << 63) - 1
"""In [ns]; RMW_DURATION_INFINITE."""


def offered_qos(qos: Qos) -> str:
    """Return `offered_qos_profiles` of a topic: YAML, a list of one profile.

    Args:
        qos: of the publisher, or of the subscription that heard it.
    """
    profile = {
        "history": _HISTORY[qos.history],
        "depth": qos.depth,
        "reliability": _RELIABILITY[qos.reliability],
        "durability": _DURABILITY[qos.durability],
        "deadline": _time(qos.deadline),
        "lifespan": _time(qos.lifespan),
        "liveliness": _LIVELINESS[qos.liveliness],
        "liveliness_lease_duration": _time(qos.liveliness_lease),
        "avoid_ros_namespace_conventions": False,
    }
    return str(yaml.safe_dump([profile], sort_keys=False))


def _time(seconds: float | None) -> dict[str, Any]:
    """Return a time in [s] in the words of rosbag2; None is for ever."""
    sec, nsec = divmod(_FOREVER if seconds is None else round(seconds * 1e9), 10**9)
    return {"sec": sec, "nsec": nsec}
