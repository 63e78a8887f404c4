"""How our own nodes reach others: by UDP, where Fast DDS by itself would take shared memory too.

A process that ends by SIGKILL leaves its ports in Fast DDS's shared memory. A later process gets
such a port, and whoever writes to it checks its health first: 335 ms in the writer's thread, now
and then 1 to 3 s, and that thread is the tick's. UDP has no such check, and takes messages of a
robot's joints as well.

Fast DDS reads the environment when a node is made; so the environment is another one meanwhile,
and processes that are started later inherit what the user set.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from unicon_base.resources import find_config
from unicon_ros import compat

TRANSPORTS = "FASTDDS_BUILTIN_TRANSPORTS"
PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
RANGE, LOCALHOST_ONLY = "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY"
# Whoever sets one of these, or has one of these files in the working folder, has chosen.
CHOICES = (TRANSPORTS, "FASTDDS_ENVIRONMENT_FILE", "ROS2_EASY_MODE")
FILES = ("DEFAULT_FASTRTPS_PROFILES.xml", "DEFAULT_FASTDDS_PROFILES.xml")
OTHERS = ("ROS_STATIC_PEERS", "ROS_DISCOVERY_SERVER")
# Those of them that the loopback profile reaches.
_LOOPBACK = re.compile(r"(127(\.\d+){3}|localhost)?(:\d+)?")

_loaded: str | None = None  # the profile that Fast DDS read, once for this process


@contextmanager
def without_shared_memory() -> Iterator[None]:
    """Keep the node that is made inside, its context included, out of Fast DDS's shared memory.

    Nothing is changed for other middlewares, nor where the user has chosen a transport.
    """
    global _loaded
    variable = compat.fast_dds_profiles()
    if variable is None:
        yield
        return
    loopback = str(find_config("dds", "no_shared_memory", ".xml"))
    unread = _loaded is None and compat.imported_first() and not compat.import_rclpy().ok()
    values = changes(os.environ, Path(), variable, loopback, unread or _loaded == loopback)
    before = {name: os.environ.get(name) for name in values}
    _set(values)
    if _loaded is None:
        _loaded = os.environ.get(variable, "")
    try:
        yield
    finally:
        _set(before)


def changes(
    environment: Mapping[str, str], folder: Path, variable: str, loopback: str, readable: bool
) -> dict[str, str | None]:
    """Return the variables to set, or to unset (None), while a node is made.

    Args:
        environment: what the user set.
        folder: where the process works.
        variable: names the profile file for this Fast DDS.
        loopback: the profile with UDP on loopback alone.
        readable: whether Fast DDS will read that profile, or has it.
    """
    if any(environment.get(name) for name in CHOICES):
        return {}
    profiles = [environment[name] for name in PROFILES if environment.get(name)]
    if not all(map(_leaves_transports, profiles)):
        return {}
    if any((folder / name).exists() for name in FILES):
        return {}
    reach = environment.get(RANGE)
    if reach == "OFF":
        return {}
    if reach != "LOCALHOST" and environment.get(LOCALHOST_ONLY) != "1":
        return {TRANSPORTS: "UDPv4"}
    # For LOCALHOST rmw_fastrtps adds shared memory to any profile, so the profile is what keeps
    # to loopback: where that is not certain, or peers are elsewhere, all stays as it is.
    others = ";".join(environment.get(name, "") for name in OTHERS).split(";")
    if not readable or not all(map(_LOOPBACK.fullmatch, others)):
        return {}
    values: dict[str, str | None] = dict.fromkeys((*PROFILES, LOCALHOST_ONLY))
    values |= {variable: loopback, RANGE: "SUBNET"}
    return values


def _leaves_transports(profile: str) -> bool:
    """Tell whether a profile is our fast discovery, which the others have too."""
    try:
        ours = find_config("dds", "fast_discovery", ".xml").read_bytes()
        return Path(profile).read_bytes() == ours
    except OSError:
        return False


def _set(values: Mapping[str, str | None]) -> None:
    for name, value in values.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value
