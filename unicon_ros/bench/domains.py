"""ROS domains for benchmarks: one that nobody on this machine is in, so that no topic is shared."""

from __future__ import annotations

import random
import socket

__all__ = ["free_domain"]

# Above 101 the ports would reach into Linux's ephemeral ones.
_DOMAINS = range(1, 102)


def free_domain() -> int:
    """Return a random domain whose first participant's port is free (RTPS 2.2, section 9.6.1)."""
    domains = random.SystemRandom().sample(_DOMAINS, len(_DOMAINS))
    return next((domain for domain in domains if _is_free(domain)), domains[0])


def _is_free(domain: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("", 7400 + 250 * domain + 10))
        except OSError:
            return False
    return True
