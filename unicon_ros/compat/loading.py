"""rclpy itself and the classes of messages, where they are installed; which middleware is used."""

from __future__ import annotations

import importlib
import os
import platform
import sys
from typing import Any

from unicon_core.errors import MissingDependencyError

_WHEELS = "pip install 'unicon_ros[ros]'"
_SOURCE = "source /opt/ros/<distro>/setup.bash"

_first: bool | None = None  # whether nobody had imported rclpy before us


def import_rclpy(what: str = "the ROS 2 bridge") -> Any:
    """Return rclpy.

    Raises:
        MissingDependencyError: it is not installed; the message names the command that installs it.
    """
    # Asynchronous writers delay the tick by up to 5.5 ms at p99; writing in the caller
    # is the default of rmw_fastrtps, held here against a profile that says otherwise.
    global _first
    os.environ.setdefault("RMW_FASTRTPS_PUBLICATION_MODE", "SYNCHRONOUS")
    if _first is None:
        _first = "rclpy" not in sys.modules
    try:
        rclpy = importlib.import_module("rclpy")
        for module in ("executors", "node", "qos", "callback_groups", "signals"):
            importlib.import_module(f"rclpy.{module}")
    except ImportError as error:
        # Where the extra's wheels are not for this machine or Python, it installs nothing.
        where = platform.system(), platform.machine(), platform.python_implementation()
        wheels = where == ("Linux", "x86_64", "CPython") and sys.version_info < (3, 15)
        install = f"{_SOURCE}, or {_WHEELS}" if wheels else _SOURCE
        raise MissingDependencyError(what, "rclpy", install) from error
    return rclpy


def imported_first() -> bool:
    """Tell whether nobody in this process can have used rclpy before us."""
    return bool(_first)


def fast_dds_profiles() -> str | None:
    """Return the variable that names Fast DDS's profile file; None for other middlewares.

    Kilted's Fast DDS 3 warns of the name that is the only one for Jazzy's 2.14.
    """
    if not is_fast_dds():
        return None
    try:
        with open("/proc/self/maps", encoding="utf-8") as libraries:
            newer = any("/libfastdds.so" in line for line in libraries)
    except OSError:  # not Linux
        newer = False
    return "FASTDDS_DEFAULT_PROFILES_FILE" if newer else "FASTRTPS_DEFAULT_PROFILES_FILE"


def is_fast_dds() -> bool:
    """Tell whether rclpy uses Fast DDS."""
    try:
        from rclpy.utilities import get_rmw_implementation_identifier
    except ImportError:
        return False
    return str(get_rmw_implementation_identifier()).startswith("rmw_fastrtps")


def message_class(name: str) -> Any:
    """Return the Python class of a type `pkg/msg/Name` or `pkg/srv/Name`, or None if absent."""
    package, kind, short = name.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.{kind}"), short, None)
    except ImportError:
        return None
