"""ROS domains for benchmarks and tests: those nobody on this machine is in, to share no topic."""

from __future__ import annotations

import os
import random
import socket
from itertools import islice

KEPT = 8
"""So many domains, the latest, stay ours though nobody is in them yet."""

_kept: dict[int, socket.socket] = {}

# Above 101 the ports would reach into Linux's ephemeral ones.
_DOMAINS = range(1, 102)


def free_domain() -> int:
    """Return a random domain whose first participant's port is free (RTPS 2.2, section 9.6.1)."""
    return free_domains(1)[0]


def free_domains(count: int) -> list[int]:
    """Return that many random domains, no two alike; taken ones where too few are free."""
    domains = random.SystemRandom().sample(_DOMAINS, len(_DOMAINS))
    free = list(islice(filter(_is_ours, domains), count))
    while len(_kept) > max(count, KEPT):
        _kept.pop(next(iter(_kept))).close()
    return [*free, *(domain for domain in domains if domain not in free)][:count]


def loopback_environment() -> dict[str, str]:
    """Return an environment for processes of ours: loopback only, a free domain of its own.

    What the ROS wheels leave in it for one interpreter only is not handed on.
    """
    values = dict(os.environ)
    if values.pop("_ROS_WHEELS_BOOTSTRAP_COMPLETE", None) is not None:
        values.pop("LD_LIBRARY_PATH", None)
    values["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    values["ROS_DOMAIN_ID"] = str(free_domain())
    return values


def stay_on_loopback() -> None:
    """Let this process's nodes stay on loopback, in a free domain, where nobody has chosen."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_DOMAIN_ID", str(free_domain()))


def _is_free(domain: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("", 7400 + 250 * domain + 10))
        except OSError:
            return False
    return True


def _is_ours(domain: int) -> bool:
    """Return whether nobody is in a domain, nor has asked for it; from now on we have.

    A process takes seconds until it is in. Of two that asked at once and got the same, one would
    hear the other's emergency stop. The mark is a name that goes with the process, on Linux only.
    """
    if domain in _kept:
        return _is_free(domain)
    mark = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        mark.bind(f"\0unicon domain {domain}")
    except OSError:
        mark.close()
        return False
    if not _is_free(domain):
        mark.close()
        return False
    _kept[domain] = mark
    return True
