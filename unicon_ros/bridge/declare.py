"""Declares parameters on a node: integers are numbers, lists may be empty; for node and session."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from unicon_base.errors import UniconError
from unicon_ros import compat
from unicon_ros.parameter_table import RANGES, WORDS

KINDS = {bool: "true or false", float: "a number", str: "a text", list: "a list of texts"}


def declare(node: Any, rows: Sequence[tuple[str, Any, str]]) -> None:
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
