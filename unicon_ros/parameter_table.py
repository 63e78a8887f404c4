"""Tables of unicon_node's parameters and services, and how parameters are declared.

For the node, sessions, launch files and documents. Integers are numbers, lists may be empty.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from unicon_base import AnyDict, UniconError
from unicon_base.located_yaml import read_yaml
from unicon_ros import compat

Row = tuple[str, Any, str]
"""Name, default and description of a parameter."""

NO_LIMIT = 100.0
"""A command limit from here on does nothing, [m/s] and [rad/s]."""

_TABLE: AnyDict = read_yaml(Path(__file__).with_suffix(".yaml")).value


def _rows(part: str) -> tuple[Row, ...]:
    return tuple((name, default, what) for name, (default, what) in _TABLE[part].items())


FRAMES, INTROSPECTION = _rows("frames"), _rows("introspection")
"""Those that `unicon run --ros` has too, after --ros-args."""
AT_CONFIGURE = (*_rows("at_configure"), *FRAMES, *INTROSPECTION)
"""Those that take effect when the node is configured."""
AT_ONCE = _rows("at_once")
DECLARED = (
    *(
        (name, value, f"{what}; takes effect when the node is configured or started anew")
        for name, value, what in AT_CONFIGURE
    ),
    *AT_ONCE,
)

LAUNCH: dict[str, tuple[str, str]] = {name: tuple(row) for name, row in _TABLE["launch"].items()}
"""Argument of the launch file, besides these, to default and description."""
SERVICES: dict[str, str] = _TABLE["services"]
"""Each `~/<name>` of type std_srvs/srv/Trigger, and what it does."""
RANGES: dict[str, tuple[float, float]] = {
    name: tuple(ends) for name, ends in _TABLE["ranges"].items()
}
"""Smallest and largest value of a number."""
SCALES = ("stiffness_scale", "damping_scale")
LIMITS = ("max_vx", "max_vy", "max_wz")
WORDS: dict[str, list[str]] = _TABLE["words"]
"""The values of a text that has a few."""

KINDS = {bool: "true or false", float: "a number", str: "a text", list: "a list of texts"}


def declare(node: Any, rows: Sequence[Row]) -> None:
    """Declare parameters on a node, those that it has already excepted.

    Integers are taken where numbers are meant, and an empty list is a list of nothing.

    Args:
        node: rclpy node.
        rows: name, default and description of each.

    Raises:
        UniconError: what was given at start is of another type.
    """
    from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor

    for name, default, description in rows:
        if node.has_parameter(name):
            continue
        descriptor = ParameterDescriptor(name=name, description=description)
        if name in WORDS:
            descriptor.additional_constraints = f"one of {', '.join(WORDS[name])}"
        if name in RANGES:
            lowest, highest = RANGES[name]
            span = FloatingPointRange(from_value=lowest, to_value=highest, step=0.0)
            descriptor.floating_point_range = [span]
        given = compat.parameter_given(node, name, default)
        value = fitted(given, default)
        texts = value if isinstance(value, list) else []
        if type(value) is not type(default) or not all(isinstance(t, str) for t in texts):
            raise UniconError(f"parameter {name} is {given!r}; give {KINDS[type(default)]}")
        if value == []:  # has no type for rclpy; a list of an empty text means the same
            value = default
        node.declare_parameter(name, value, descriptor, ignore_override=True)


def fitted(value: Any, default: Any) -> Any:
    """Return a value as the type of a default where it means the same, else as it is."""
    if isinstance(default, float) and type(value) is int:
        return float(value)
    if isinstance(default, list) and (value is None or hasattr(value, "__len__")):
        return value if isinstance(value, str) else list(value or [])
    return value
