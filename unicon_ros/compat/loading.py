"""rclpy itself and the classes of messages, where they are installed; which middleware is used.

And parameters as they were given, made to fit before rclpy looks at their types.
"""

from __future__ import annotations

import importlib
import os
import platform
import sys
from collections.abc import Callable
from typing import Any

from unicon_base import AnyMapping, MissingDependencyError

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
    return middleware().startswith("rmw_fastrtps")


def middleware() -> str:
    """Return the middleware that rclpy uses, such as `rmw_fastrtps_cpp`; "" without rclpy."""
    try:
        from rclpy.utilities import get_rmw_implementation_identifier
    except ImportError:
        return ""
    return str(get_rmw_implementation_identifier())


def message_class(name: str) -> Any:
    """Return the Python class of a type `pkg/msg/Name` or `pkg/srv/Name`, or None if absent."""
    package, kind, short = name.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.{kind}"), short, None)
    except ImportError:
        return None


def parameters_given(node: Any) -> AnyMapping:
    """Return the parameters that a node was given at start, by name; none where rclpy hides it."""
    return getattr(node, "_parameter_overrides", {})


def parameter_given(node: Any, name: str, default: Any) -> Any:
    """Return what was given at start for a parameter that is not declared yet, of any type.

    An empty list has no type in rcl, which hands over a parameter that is not set: that is None.
    """
    from rcl_interfaces.msg import ParameterDescriptor

    if name not in parameters_given(node) and hasattr(node, "_parameter_overrides"):
        return default  # nothing was given, as nearly always
    # Public and of any type: declared, read and taken back.
    descriptor = ParameterDescriptor(dynamic_typing=True)
    value = node.declare_parameter(name, None, descriptor).value
    node.undeclare_parameter(name)
    return default if value is None and not isinstance(default, list) else value


def convert_parameters(node: Any, fitted: Callable[[str, Any], tuple[Any, Any]]) -> bool:
    """Let what is set be made to fit first; False where rclpy cannot (Humble).

    Args:
        node: rclpy node.
        fitted: returns the value for a name and a value, and the number of its type or None where
            rclpy is to guess it.
    """
    from rclpy.parameter import Parameter

    add = getattr(node, "add_pre_set_parameters_callback", None)
    if add is None:
        return False

    def convert(parameters: list[Any]) -> list[Any]:
        made = []
        for parameter in parameters:
            if parameter.type_ == Parameter.Type.NOT_SET:  # to be removed
                made.append(parameter)
                continue
            value, kind = fitted(parameter.name, parameter.value)
            if kind is not None:
                made.append(Parameter(parameter.name, Parameter.Type(kind), value))
            elif value is not parameter.value and type(value) is not type(parameter.value):
                made.append(Parameter(parameter.name, value=value))
            else:
                made.append(parameter)
        return made

    add(convert)
    return True
